"""DQN's updates as machine code for the CPU: many of them, of all replicates, in one call.

They compute what TorchRL's loss, torch's Adam and the target update compute, in float32, for networks of linear layers
with ReLU between them; tests compare the two. One replicate comes after the other, so none depends on who learns beside
it.

Shapes: `A` replicates, `U` updates, `N` transitions of a minibatch, `C` of the memory; `O` values of an observation,
`K` actions; `L` layers, of `I` inputs and `J` outputs each; `S` units of all layers together.
Within an update a row has one unit's values, of all transitions, so that each of them is a lane of the processor.
"""

import math
from typing import Any, NamedTuple

import numpy as np

from carrl.machine_code import apart, compiled, inlined, reordering


class Rule(NamedTuple):
    """What the updates have in common.

    Attributes:
        sizes: of the observation, of each layer and so of the values of all actions, [L + 1], int64.
        offsets: where each layer's weights and then its biases begin, of the first replicate, [L, 2], int64.
        input_exponent: that observations are raised to first, signs kept.
        gamma: discount factor.
        double_dqn: whether the trained network picks the next action.
        huber: whether the loss grows linearly where the TD error exceeds 1.
        gap_weight: share of its gap to the best action that an action's reward falls by.
        excess_weight: of the conservative term.
        max_norm: of the gradient; infinite for no limit.
        tau: share of the way that the target network moves after each update; 0 where it is copied elsewhere.
        beta_1, beta_2, eps: of Adam.
    """

    sizes: np.ndarray
    offsets: np.ndarray
    input_exponent: float
    gamma: float
    double_dqn: bool
    huber: bool
    gap_weight: float
    excess_weight: float
    max_norm: float
    tau: float
    beta_1: float
    beta_2: float
    eps: float


class Parameters(NamedTuple):
    """What updates change: each layer's weights [A, J, I] and biases [A, J], one after the other, in float32.

    Attributes:
        network, target: the trained network's and the target network's.
        mean, square: Adam's running means of the gradient and of its square.
        step: how many steps Adam has made, by whichever parameter.
    """

    network: np.ndarray
    target: np.ndarray
    mean: np.ndarray
    square: np.ndarray
    step: np.ndarray


class Memory(NamedTuple):
    """The transitions: observations [C, A, O], float32, and of the rest [C, A].

    Attributes:
        steps: from an observation to the next one, int64; empty where it is one step always.
    """

    observation: np.ndarray
    action: np.ndarray
    next_observation: np.ndarray
    reward: np.ndarray
    terminated: np.ndarray
    steps: np.ndarray


class Work(NamedTuple):
    """Room for one update after the other; float32 but for the actions.

    Attributes:
        before, after: the observations, [O, N].
        action: that was taken, [N], int64.
        goal: what its value should be, [N]; the reward at first.
        discount: of what comes after it, [N]; 0 where nothing does.
        share: of the transition in the loss, [N].
        units: of the trained network: what comes out of each unit, [S, N].
        target: of the target network.
        slopes: of the loss, by what comes out of each unit, [S, N].
        gradient: by each parameter of one replicate, layer by layer, weights before biases.
    """

    before: np.ndarray
    after: np.ndarray
    action: np.ndarray
    goal: np.ndarray
    discount: np.ndarray
    share: np.ndarray
    units: np.ndarray
    target: np.ndarray
    slopes: np.ndarray
    gradient: np.ndarray


def make_work(sizes: np.ndarray, batch_size: int) -> Work:
    """The room for networks with layers of these sizes, [L + 1]."""
    inputs, units = (int(sizes[0]), batch_size), (int(sizes[1:].sum()), batch_size)
    weights = int((sizes[:-1] * sizes[1:]).sum() + sizes[1:].sum())
    kinds: list[tuple[Any, type]] = [(inputs, np.float32)] * 2 + [(batch_size, np.int64)]
    kinds += [(batch_size, np.float32)] * 3 + [(units, np.float32)] * 3 + [(weights, np.float32)]
    return Work(*(np.zeros(shape, kind) for shape, kind in kinds))


@compiled
def update(
    rule: Rule,
    parameters: Parameters,
    memory: Memory,
    work: Work,
    items: np.ndarray,
    weights: np.ndarray,
    rates: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """Makes updates, one after the other.

    Args:
        rule: how.
        parameters: which change.
        memory: of the transitions.
        work: room for them.
        items: places of the minibatches in it, [U, N, A], int64.
        weights: by which the losses of transitions count, [U, N, A], float32; empty where they count alike.
        rates: learning rates, [U], float64.

    Returns:
        The losses before each update, [U, A], float32, and the squared TD errors, [U, N, A], float32.

    Raises:
        ValueError: a transition is not in the memory, or has an action that there is not.
    """
    updates, _, replicates = items.shape
    losses, td_errors = np.empty((updates, replicates), np.float32), np.empty(items.shape, np.float32)
    taken = np.float64(parameters.step[0])
    for replicate in range(replicates):
        for number in range(updates):
            _gather(rule.sizes[-1], rule.gamma, rule.input_exponent, memory, items[number], replicate, work)
            _weigh(weights[number : number + 1], replicate, work.share)
            _aim(rule, parameters, replicate, work)
            _forward(rule.sizes, rule.offsets, parameters.network, replicate, work.before, work.units)
            losses[number, replicate] = _compare(rule, work, td_errors[number, :, replicate])
            _backward(rule.sizes, rule.offsets, parameters.network, replicate, work)
            _move(rule, parameters, work.gradient, replicate, rates[number], taken + number + 1)
    for each in range(len(parameters.step)):
        parameters.step[each] += np.float32(updates)
    return losses, td_errors


@apart
def _gather(
    actions: int,
    gamma: float,
    input_exponent: float,
    memory: Memory,
    items: np.ndarray,
    replicate: int,
    work: Work,
) -> None:
    """Fetches the transitions at these places, [N, A], in one go: where the memory is large, most of them are far."""
    inputs = memory.observation.shape[2]
    for place in range(len(items)):
        item = items[place, replicate]
        if not 0 <= item < len(memory.action):
            raise ValueError("there is no such transition in the memory")
        work.action[place] = memory.action[item, replicate]
        if not 0 <= work.action[place] < actions:
            raise ValueError("there is an action in the memory that the network does not value")
        work.goal[place] = memory.reward[item, replicate]
        work.discount[place] = np.float32(0) if memory.terminated[item, replicate] else np.float32(gamma)
        for value in range(inputs):
            work.before[value, place] = memory.observation[item, replicate, value]
            work.after[value, place] = memory.next_observation[item, replicate, value]
    if len(memory.steps):
        for place in range(len(items)):
            if work.discount[place] > 0:
                work.discount[place] = gamma ** memory.steps[items[place, replicate], replicate]
    if input_exponent != 1:
        for value in range(inputs):
            for place in range(len(items)):
                for observation in (work.before, work.after):
                    read = observation[value, place]
                    observation[value, place] = math.copysign(abs(read) ** input_exponent, read)


@apart
def _weigh(weights: np.ndarray, replicate: int, share: np.ndarray) -> None:
    """Writes the shares of the transitions in the loss, [N]: of weights [1, N, A], or none where they count alike."""
    if not weights.size:
        for place in range(len(share)):
            share[place] = np.float32(1) / len(share)
        return
    total = np.float32(0)
    for place in range(len(share)):
        total += weights[0, place, replicate]
    for place in range(len(share)):
        share[place] = weights[0, place, replicate] / total


@inlined
def _aim(rule: Rule, parameters: Parameters, replicate: int, work: Work) -> None:
    """Adds to the rewards what the target network expects after them."""
    last = len(work.units) - rule.sizes[-1]
    if rule.double_dqn:
        _forward(rule.sizes, rule.offsets, parameters.network, replicate, work.after, work.units)
    _forward(rule.sizes, rule.offsets, parameters.target, replicate, work.after, work.target)
    _look_ahead(work.units[last:] if rule.double_dqn else work.target[last:], work.target[last:], work)
    if rule.gap_weight > 0:
        _forward(rule.sizes, rule.offsets, parameters.target, replicate, work.before, work.target)
        _lower(work.target[last:], np.float32(rule.gap_weight), work)


@apart
def _look_ahead(choosing: np.ndarray, values: np.ndarray, work: Work) -> None:
    """Adds the discounted value of the action that is chosen next: of all actions [K, N]."""
    for place in range(len(work.goal)):
        best = 0
        for action in range(1, len(choosing)):
            best = action if choosing[action, place] > choosing[best, place] else best
        work.goal[place] += work.discount[place] * values[best, place]


@apart
def _lower(values: np.ndarray, weight: float, work: Work) -> None:
    """Takes away a share of how far the action falls behind the best one: of the values of all actions [K, N]."""
    for place in range(len(work.goal)):
        best = values[0, place]
        for action in range(1, len(values)):
            best = max(best, values[action, place])
        work.goal[place] -= weight * (best - values[work.action[place], place])


@inlined
def _compare(rule: Rule, work: Work, td_errors: np.ndarray) -> float:
    """The loss, whose slopes by the actions' values it writes, and the squared TD errors, [N]."""
    last = len(work.units) - rule.sizes[-1]
    values, slopes = work.units[last:], work.slopes[last:]
    loss = _compare_taken(rule.huber, values, work, slopes, td_errors)
    if rule.excess_weight > 0:
        loss += rule.excess_weight * _exceed(rule.excess_weight, values, work, slopes)
    return loss


@apart
def _compare_taken(huber: bool, values: np.ndarray, work: Work, slopes: np.ndarray, td_errors: np.ndarray) -> float:
    """The same without the conservative term: of the values of all actions, [K, N], and their slopes."""
    loss = 0.0
    for place in range(len(work.goal)):
        taken, share = work.action[place], work.share[place]
        error = values[taken, place] - work.goal[place]
        td_errors[place] = error * error
        for action in range(len(values)):
            slopes[action, place] = 0
        if not huber:
            loss += share * (error * error)
            slopes[taken, place] = share * (2 * error)
        elif abs(error) < 1:
            loss += share * (error * error / 2)
            slopes[taken, place] = share * error
        else:
            loss += share * (abs(error) - np.float32(0.5))
            slopes[taken, place] = math.copysign(share, error)
    return loss


@apart
def _exceed(weight: float, values: np.ndarray, work: Work, slopes: np.ndarray) -> float:
    """How far the actions' values [K, N] in all exceed those of the ones taken; adds this term's slopes, [K, N]."""
    excess, count = 0.0, values.shape[1]
    for place in range(count):
        highest, total = values[0, place], 0.0
        for action in range(1, len(values)):
            highest = max(highest, values[action, place])
        for action in range(len(values)):
            total += math.exp(values[action, place] - highest)
        for action in range(len(values)):
            slopes[action, place] += weight / count * math.exp(values[action, place] - highest) / total
        slopes[work.action[place], place] -= weight / count
        excess += math.log(total) + highest - values[work.action[place], place]
    return excess / count


@apart
def _forward(
    sizes: np.ndarray, offsets: np.ndarray, network: np.ndarray, replicate: int, read: np.ndarray, units: np.ndarray
) -> None:
    """Computes all units, [S, N], from the observations, [O, N]."""
    begin = 0
    for layer in range(len(sizes) - 1):
        inputs, outputs = sizes[layer], sizes[layer + 1]
        first, first_bias = offsets[layer, 0] + replicate * inputs * outputs, offsets[layer, 1] + replicate * outputs
        weights = network[first : first + inputs * outputs].reshape((outputs, inputs))
        written = units[begin : begin + outputs]
        _multiply(weights, network[first_bias : first_bias + outputs], read, written)
        if layer < len(sizes) - 2:
            _rectify(written)
        begin, read = begin + outputs, written


@apart
def _backward(sizes: np.ndarray, offsets: np.ndarray, network: np.ndarray, replicate: int, work: Work) -> None:
    """Computes the gradient from the slopes by the last layer's units."""
    end, after = len(work.units), len(work.gradient)
    for layer in range(len(sizes) - 2, -1, -1):
        inputs, outputs = sizes[layer], sizes[layer + 1]
        begin = end - outputs
        slopes, read = work.slopes[begin:end], work.units[begin - inputs : begin] if layer > 0 else work.before
        middle = after - outputs
        before = middle - inputs * outputs
        _correlate(slopes, read, work.gradient[before:middle].reshape((outputs, inputs)))
        _add_up(slopes, work.gradient[middle:after])
        if layer > 0:
            first = offsets[layer, 0] + replicate * inputs * outputs
            weights = network[first : first + inputs * outputs].reshape((outputs, inputs))
            own = work.slopes[begin - inputs : begin]
            _multiply(weights.T, np.zeros(inputs, np.float32), slopes, own)
            _let_through(read, own)
        end, after = begin, before


@inlined
def _move(rule: Rule, parameters: Parameters, gradient: np.ndarray, replicate: int, rate: float, taken: float) -> None:
    """One step of Adam, and of the target network if it follows; of the gradient in the order of `Work.gradient`."""
    share = np.float32(1)
    if rule.max_norm < np.inf:
        norm = math.sqrt(_norm_squared(gradient))
        share = np.float32(min(rule.max_norm / (norm + 1e-6), 1.0))  # as torch.nn.utils.clip_grad_norm_
    unbiased_mean, unbiased_square = 1 - rule.beta_1**taken, 1 - rule.beta_2**taken
    read = 0
    for layer in range(len(rule.sizes) - 1):
        outputs = rule.sizes[layer + 1]
        for kind in range(2):
            size = outputs * rule.sizes[layer] if kind == 0 else outputs
            begin = rule.offsets[layer, kind] + replicate * size
            end = begin + size
            _adam(
                gradient[read : read + size],
                parameters.network[begin:end],
                parameters.mean[begin:end],
                parameters.square[begin:end],
                share,
                np.float32(rate / unbiased_mean),
                np.float32(1 / unbiased_square),
                np.float32(1 - rule.beta_1),  # in float32 it would be off by its fifth digit
                np.float32(rule.beta_2),
                np.float32(1 - rule.beta_2),
                np.float32(rule.eps),
            )
            if rule.tau > 0:
                _follow(parameters.target[begin:end], parameters.network[begin:end], np.float32(rule.tau))
            read += size


@reordering
def _multiply(weights: np.ndarray, biases: np.ndarray, read: np.ndarray, written: np.ndarray) -> None:
    """A layer, [J, I] and [J], of inputs [I, N] to outputs [J, N]: four inputs at a time."""
    inputs, count = read.shape
    for unit in range(len(written)):
        row, out, bias = weights[unit], written[unit], biases[unit]
        for place in range(count):
            out[place] = bias
        for first in range(0, inputs - 3, 4):
            a, b, c, d = row[first], row[first + 1], row[first + 2], row[first + 3]
            p, q, r, s = read[first], read[first + 1], read[first + 2], read[first + 3]
            for place in range(count):
                out[place] += a * p[place] + b * q[place] + c * r[place] + d * s[place]
        for each in range(inputs - inputs % 4, inputs):
            a, p = row[each], read[each]
            for place in range(count):
                out[place] += a * p[place]


@reordering
def _correlate(slopes: np.ndarray, read: np.ndarray, weights: np.ndarray) -> None:
    """The slopes by a layer's weights, [J, I], of those by its outputs [J, N] and of its inputs [I, N]."""
    inputs, count = read.shape
    for unit in range(len(slopes)):
        own = slopes[unit]
        for first in range(0, inputs - 3, 4):
            p, q, r, s = read[first], read[first + 1], read[first + 2], read[first + 3]
            a, b, c, d = np.float32(0), np.float32(0), np.float32(0), np.float32(0)
            for place in range(count):
                a += own[place] * p[place]
                b += own[place] * q[place]
                c += own[place] * r[place]
                d += own[place] * s[place]
            weights[unit, first], weights[unit, first + 1] = a, b
            weights[unit, first + 2], weights[unit, first + 3] = c, d
        for each in range(inputs - inputs % 4, inputs):
            a, p = np.float32(0), read[each]
            for place in range(count):
                a += own[place] * p[place]
            weights[unit, each] = a


@reordering
def _rectify(units: np.ndarray) -> None:
    """ReLU, which leaves what is no number as it is."""
    for unit in range(len(units)):
        row = units[unit]
        for place in range(len(row)):
            row[place] = np.float32(0) if row[place] < 0 else row[place]


@reordering
def _let_through(units: np.ndarray, slopes: np.ndarray) -> None:
    """Sets the slopes to 0 where ReLU has cut the units off."""
    for unit in range(len(units)):
        row, own = units[unit], slopes[unit]
        for place in range(len(row)):
            own[place] = np.float32(0) if row[place] <= 0 else own[place]


@reordering
def _add_up(slopes: np.ndarray, biases: np.ndarray) -> None:
    """The slopes by a layer's biases, [J], of those by its outputs, [J, N]."""
    for unit in range(len(slopes)):
        total = np.float32(0)
        for place in range(slopes.shape[1]):
            total += slopes[unit, place]
        biases[unit] = total


@reordering
def _norm_squared(values: np.ndarray) -> float:
    total = 0.0
    for each in range(len(values)):
        total += np.float64(values[each]) * values[each]
    return total


@reordering
def _adam(
    gradient: np.ndarray,
    parameters: np.ndarray,
    mean: np.ndarray,
    square: np.ndarray,
    share: float,
    rate: float,
    unbiased: float,
    new_in_mean: float,
    beta_2: float,
    new_in_square: float,
    eps: float,
) -> None:
    """One step of some parameters, [F] each.

    Args:
        gradient: before it is clipped to a share of itself.
        parameters: that change.
        mean: of the gradient; it changes.
        square: of the gradient's square; it changes.
        share: of the gradient.
        rate: the learning rate over what the mean is to be divided by.
        unbiased: what the square is to be multiplied by.
        new_in_mean: share of the gradient in the mean, 1 - beta_1.
        beta_2: of Adam.
        new_in_square: share of the gradient's square, 1 - beta_2.
        eps: of Adam.
    """
    for each in range(len(gradient)):
        slope = gradient[each] * share
        mean[each] += new_in_mean * (slope - mean[each])
        square[each] = square[each] * beta_2 + new_in_square * (slope * slope)
        parameters[each] -= rate * mean[each] / (np.sqrt(square[each] * unbiased) + eps)


@reordering
def _follow(target: np.ndarray, network: np.ndarray, tau: float) -> None:
    for each in range(len(target)):
        target[each] += tau * (network[each] - target[each])
