"""Multilayer perceptron of the learned strain: amplitudes c(q) of its fields, with their first and second derivatives along a motion.

Layers are products of packs with weights in the layout of types.Network, activations s(a) = a / sqrt(1 + a^2). Derivatives go forward, a
row each: the rate, the acceleration at q_ddot = 0, and along every tension.
"""

from soft_tendon_env.compiler.compilation import kernel
from soft_tendon_env.mechanics.algebra.lanes import LANES, load, spread, sqrt, store


@kernel(inline=True)
def activation(a):
    """s = a / sqrt(1 + a^2) and its first two derivatives."""
    inverse = 1.0 / sqrt(1.0 + a * a)
    slope = inverse * inverse * inverse
    return a * inverse, slope, -3.0 * a * slope * inverse * inverse


@kernel
def layer(weights, inputs, outputs, memory, at, out):
    """The product W^T x of a layer, of memory[at:] into memory[out:]."""
    for m in range(0, outputs, 2 * LANES):
        left, right = spread(0.0), spread(0.0)
        for k in range(inputs):
            x = memory[at + k]
            left, right = left + x * load(weights, k * outputs + m), right + x * load(weights, k * outputs + m + LANES)
        store(memory, out + m, left)
        store(memory, out + m + LANES, right)


@kernel
def layer_of_rows(weights, inputs, outputs, rows, memory, at, out):
    """The products W^T x of a layer, of rows in memory[at:] into rows in memory[out:], four and two packs at a time."""
    for first in range(0, rows, 4):
        second, third, fourth = min(first + 1, rows - 1), min(first + 2, rows - 1), min(first + 3, rows - 1)  # the last one again
        a, b, c, d = at + first * inputs, at + second * inputs, at + third * inputs, at + fourth * inputs
        for m in range(0, outputs, 2 * LANES):
            none = spread(0.0)
            a_0, a_1, b_0, b_1, c_0, c_1, d_0, d_1 = none, none, none, none, none, none, none, none
            for k in range(inputs):
                w_0, w_1 = load(weights, k * outputs + m), load(weights, k * outputs + m + LANES)
                a_0, a_1 = a_0 + memory[a + k] * w_0, a_1 + memory[a + k] * w_1
                b_0, b_1 = b_0 + memory[b + k] * w_0, b_1 + memory[b + k] * w_1
                c_0, c_1 = c_0 + memory[c + k] * w_0, c_1 + memory[c + k] * w_1
                d_0, d_1 = d_0 + memory[d + k] * w_0, d_1 + memory[d + k] * w_1
            _store_pair(memory, out + first * outputs + m, a_0, a_1)
            _store_pair(memory, out + second * outputs + m, b_0, b_1)
            _store_pair(memory, out + third * outputs + m, c_0, c_1)
            _store_pair(memory, out + fourth * outputs + m, d_0, d_1)


@kernel(inline=True)
def _store_pair(memory, at, left, right):
    store(memory, at, left)
    store(memory, at + LANES, right)


@kernel
def activate(bias, hidden, memory, at, value, prime, second):
    """s, s' and s'' of a hidden layer, of memory[at:] and its bias."""
    for m in range(0, hidden, LANES):
        s, slope, curvature = activation(load(memory, at + m) + load(bias, m))
        store(memory, value + m, s)
        store(memory, prime + m, slope)
        store(memory, second + m, curvature)


@kernel(counted=True)
def amplitudes(strain, q, memory):
    """z = [q; c(q)], and the hidden layers' derivatives."""
    net, places, n = strain.network, strain.places, strain.size
    for j in range(n):
        memory[places.z + j] = q[j]
    layer(net.first, net.inputs, net.hidden, memory, places.z, places.summed)
    activate(net.first_bias, net.hidden, memory, places.summed, places.s_1, places.s_1_prime, places.s_1_second)
    layer(net.second, net.hidden, net.hidden, memory, places.s_1, places.summed)
    activate(net.second_bias, net.hidden, memory, places.summed, places.s_2, places.s_2_prime, places.s_2_second)
    layer(net.third, net.hidden, net.outputs, memory, places.s_2, places.z + n)
    for m in range(0, net.outputs, LANES):
        store(memory, places.z + n + m, load(memory, places.z + n + m) + load(net.third_bias, m))
    return memory[places.z : places.z + strain.whole.size]


@kernel(counted=True)
def amplitude_rates(strain, q_dot, rows, memory):
    """z_dot = [q_dot; c_dot], c_ddot at q_ddot = 0 and, of `rows` in all, dc/dq by tensions; after amplitudes()."""
    net, places, n, hidden = strain.network, strain.places, strain.size, strain.network.hidden
    for j in range(n):
        memory[places.z_dot + j] = q_dot[j]
    layer(net.first, net.inputs, hidden, memory, places.z_dot, places.summed)
    for m in range(0, hidden, LANES):
        rate, slope = load(memory, places.summed + m), load(memory, places.s_1_prime + m)
        store(memory, places.rows_1 + m, slope * rate)
        store(memory, places.rows_1 + hidden + m, load(memory, places.s_1_second + m) * rate * rate)
        for row in range(2, rows):
            store(memory, places.rows_1 + row * hidden + m, slope * load(net.first, (row - 2) * hidden + m))
    layer_of_rows(net.second, hidden, hidden, rows, memory, places.rows_1, places.rows_2)
    for m in range(0, hidden, LANES):
        rate, slope = load(memory, places.rows_2 + m), load(memory, places.s_2_prime + m)
        for row in range(rows):
            at = places.rows_2 + row * hidden + m
            store(memory, at, slope * load(memory, at))
        at = places.rows_2 + hidden + m
        store(memory, at, load(memory, at) + load(memory, places.s_2_second + m) * rate * rate)
    layer_of_rows(net.third, hidden, net.outputs, rows, memory, places.rows_2, places.rates)
    for m in range(0, net.outputs, LANES):
        store(memory, places.z_dot + n + m, load(memory, places.rates + m))
    return memory[places.z_dot : places.z_dot + strain.whole.size]
