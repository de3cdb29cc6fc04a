"""Multilayer perceptron of the learned strain: amplitudes c(q) of its fields, with their first and second derivatives along a motion.

Layers are products of packs with weights in the layout of types.Network, activations s(a) = a / sqrt(1 + a^2). Derivatives go forward, a
row each: the rate, the acceleration at q_ddot = 0, and along every tension.
"""

from soft_tendon_env.compiler.compilation import kernel
from soft_tendon_env.mechanics.algebra.lanes import LANES, load, spread, sqrt, store
from soft_tendon_env.mechanics.algebra.linear import copy


@kernel(inline=True)
def activation(a):
    """Activation s = a / sqrt(1 + a^2) and its first two derivatives."""
    inverse = 1.0 / sqrt(1.0 + a * a)
    slope = inverse * inverse * inverse
    return a * inverse, slope, -3.0 * a * slope * inverse * inverse


@kernel
def layer(weights, x, out):
    """Product W^T x of a layer, as wide as `out`; x may be longer than its inputs."""
    outputs = out.size
    for m in range(0, outputs, 2 * LANES):
        left, right = spread(0.0), spread(0.0)
        for k in range(weights.size // outputs):
            left, right = left + x[k] * load(weights, k * outputs + m), right + x[k] * load(weights, k * outputs + m + LANES)
        _store_pair(out, m, left, right)


@kernel
def layer_of_rows(weights, rows, x, out):
    """Products W^T x of a layer, of the first `rows` rows of x into those of out, four and two packs at a time."""
    outputs = out.shape[1]
    for first in range(0, rows, 4):
        second, third, fourth = min(first + 1, rows - 1), min(first + 2, rows - 1), min(first + 3, rows - 1)  # the last one again
        a, b, c, d = x[first], x[second], x[third], x[fourth]
        for m in range(0, outputs, 2 * LANES):
            none = spread(0.0)
            a_0, a_1, b_0, b_1, c_0, c_1, d_0, d_1 = none, none, none, none, none, none, none, none
            for k in range(a.size):
                w_0, w_1 = load(weights, k * outputs + m), load(weights, k * outputs + m + LANES)
                a_0, a_1 = a_0 + a[k] * w_0, a_1 + a[k] * w_1
                b_0, b_1 = b_0 + b[k] * w_0, b_1 + b[k] * w_1
                c_0, c_1 = c_0 + c[k] * w_0, c_1 + c[k] * w_1
                d_0, d_1 = d_0 + d[k] * w_0, d_1 + d[k] * w_1
            _store_pair(out[first], m, a_0, a_1)
            _store_pair(out[second], m, b_0, b_1)
            _store_pair(out[third], m, c_0, c_1)
            _store_pair(out[fourth], m, d_0, d_1)


@kernel(inline=True)
def _store_pair(out, at, left, right):
    store(out, at, left)
    store(out, at + LANES, right)


@kernel
def activate(bias, summed, value, prime, second):
    """Values s, s' and s'' of a hidden layer, of its summed inputs and its bias."""
    for m in range(0, summed.size, LANES):
        s, slope, curvature = activation(load(summed, m) + load(bias, m))
        store(value, m, s)
        store(prime, m, slope)
        store(second, m, curvature)


@kernel(counted=True)
def amplitudes(strain, q, memory):
    """Coordinates and amplitudes z = [q; c(q)]; leaves the hidden layers' derivatives."""
    net, n = strain.network, strain.size
    c = memory.z[n:]
    copy(q, memory.z[:n])
    layer(net.first, memory.z, memory.summed)
    activate(net.first_bias, memory.summed, memory.s_1, memory.s_1_prime, memory.s_1_second)
    layer(net.second, memory.s_1, memory.summed)
    activate(net.second_bias, memory.summed, memory.s_2, memory.s_2_prime, memory.s_2_second)
    layer(net.third, memory.s_2, c)
    for m in range(0, net.outputs, LANES):
        store(c, m, load(c, m) + load(net.third_bias, m))
    return memory.z[: strain.whole.size]


@kernel(counted=True)
def amplitude_rates(strain, q_dot, rows, memory):
    """Rates z_dot = [q_dot; c_dot]; leaves c_ddot at q_ddot = 0 and, of `rows` in all, dc/dq by tensions; after amplitudes()."""
    net, n, hidden, rows_1, rows_2 = strain.network, strain.size, strain.network.hidden, memory.rows_1, memory.rows_2
    copy(q_dot, memory.z_dot[:n])
    layer(net.first, memory.z_dot, memory.summed)
    for m in range(0, hidden, LANES):
        rate, slope = load(memory.summed, m), load(memory.s_1_prime, m)
        store(rows_1[0], m, slope * rate)
        store(rows_1[1], m, load(memory.s_1_second, m) * rate * rate)
        for row in range(2, rows):
            store(rows_1[row], m, slope * load(net.first, (row - 2) * hidden + m))
    layer_of_rows(net.second, rows, rows_1, rows_2)
    for m in range(0, hidden, LANES):
        rate, slope = load(rows_2[0], m), load(memory.s_2_prime, m)
        for row in range(rows):
            store(rows_2[row], m, slope * load(rows_2[row], m))
        store(rows_2[1], m, load(rows_2[1], m) + load(memory.s_2_second, m) * rate * rate)
    layer_of_rows(net.third, rows, rows_2, memory.rates)
    copy(memory.rates[0], memory.z_dot[n:])
    return memory.z_dot[: strain.whole.size]
