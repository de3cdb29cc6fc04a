"""Status codes of a time step, and the message of each: what steps, batches and simulations return
and people read."""

OK = 0
NO_STRAIN = 1
NOT_POSITIVE = 2
NOT_FINITE = 3
INACCURATE = 4
PENETRATED = 5
COMMAND_QUEUE_FULL = 6
UNSETTLED = 7

MESSAGES = {
    NO_STRAIN: "no strain balances the coordinates",
    NOT_POSITIVE: "the mass or step matrix is not positive definite",
    NOT_FINITE: "the coordinates are not finite",
    INACCURATE: "the estimated error is too large",
    PENETRATED: (
        "the arm is pressed through an obstacle, or too deep into it, in steps of any length"
    ),
    COMMAND_QUEUE_FULL: (
        "commands change more often than the delay of their path keeps, once every integrator.step"
    ),
    UNSETTLED: "the friction of the tendons has no balance",
}
