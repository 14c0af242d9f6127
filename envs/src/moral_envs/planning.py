"""Plans for Delivery, certified on both sides: what they return, and what no plan can exceed.

Nothing in Delivery is random after the start, so for one agent a plan is a sequence of actions. The best one
solves an orienteering problem: collect as much as the horizon allows, perhaps break a vase on the way. Here

- the return of a plan is what the engine pays when its actions are replayed (:func:`replay`), which makes it
  a lower bound of the optimum, and
- an upper bound comes from a relaxation and a search that prove it as follows.

The upper bound
---------------
*Relaxation.* Let every plan forget: an object may be collected again once the agent has entered a cell that
does not remember it, and of all vases broken only the first costs its weight ``w``. Every plan is still
allowed and none is charged more than before. Now charge each collection of object j a price of at least
0 and refund all prices once. A true plan collects j at most once, so it loses no more than it is refunded:
for any prices, the best relaxed plan plus the refund is at least the optimum (Lagrangian relaxation). The
best relaxed plan follows by dynamic programming over (steps left, cell, remembered objects, whether a vase is
broken). Prices descend along the subgradient, which is 1 minus how often the best relaxed plan collects each
object; the cells on the way between two collections of one object learn to remember it.

*Rounding.* A return is a sum of weights, so the bound may be rounded down to the greatest such sum.

*Search.* The relaxed value to go, with the prices of the objects left, bounds what a partial plan can still
come to. A breadth-first search over steps drops partial plans whose bound allows nothing above the best plan
found, keeps one of those that agree in cell, objects left and vases left, and then the ``beam_width`` with
the highest bounds. Plans that wait before their end, or undo a move at once, need not be looked at: leaving
these steps out costs nothing. So a shortest optimal plan survives unless the best one found is as good or it
was cut for width, and the optimum is at most the greater of the best return and the highest bound that was
cut. When nothing had to be cut, the best plan found is optimal.

Sources: state-space relaxation is by Christofides, Mingozzi and Toth (Networks 11, 1981), the memory of cells
follows the ng-routes of Baldacci, Mingozzi and Roberti (Operations Research 59, 2011) and their growth that
of Roberti and Mingozzi (Transportation Science 48, 2014), the step length is Polyak's (1969). The world is
that of Peschl et al., "MORAL", AAMAS 2022.

A *start* is an observation of a one-agent Delivery world: 0/1 planes ``(6, height, width)`` in the order
walls, agent, deliveries, people, pollution, vases. Any state will do, also one in mid-episode; ``horizon``
counts the steps that remain. Walls inside the border are respected.
"""

from __future__ import annotations

from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from moral_envs import delivery_v0
from moral_envs.arguments import require_integer
from moral_envs.array_arguments import refuse_first, require_planes, require_weights
from moral_envs.engine import Engine
from moral_envs.outcomes import FIRST_OBJECT, FREE, WAIT, WALL
from moral_envs.world import NUM_ACTIONS, NUM_MOVES

__all__ = ["Plans", "plan", "replay"]

_NUM_PLANES = 6
_COMPONENTS = ("deliver", "help", "clean", "vase")
_VASE = 3
# The move that undoes each action.
_UNDOES = np.array([1, 0, 3, 2] + [-1] * (NUM_ACTIONS - NUM_MOVES))

# Objects that a cell may remember: few at first, for speed, then more for the starts that stay open.
_MEMORY_LIMITS = (5, 8)
# Descents between two searches, and the width of these.
_SWEEP = 10
_NARROW = 300
# Sums of weights beyond which bounds are not rounded down.
_MAX_SUMS = 2**20
# Relative to the greatest weight; far above the rounding errors of sums over an episode.
_TOLERANCE = 1e-9


class Plans(NamedTuple):
    """What :func:`plan` found for a batch of starts."""

    actions: NDArray[np.int64]
    """Delivery's actions, shape (n, horizon)."""
    returns: NDArray[np.float64]
    """What the engine pays for them: the return of each reward component, shape (n, 4)."""
    upper_bounds: NDArray[np.float64]
    """Scalarised returns that no plan exceeds, shape (n,), up to rounding errors of 1e-9 times the greatest
    weight. Where ``returns @ weights`` is as high, the plan is optimal."""


def plan(
    starts: ArrayLike,
    horizon: int,
    weights: ArrayLike,
    *,
    beam_width: int = 20_000,
    iterations: int = 120,
) -> Plans:
    """Plan for a high scalarised return from every start, and bound the optimum from above.

    Parameters
    ----------
    starts
        0/1 planes of shape (n, 6, height, width), as one agent observes them.
    horizon
        Steps to plan for, at least 0.
    weights
        Scalarisation weights over the reward vector (deliver, help, clean, vase): shape (4,), nonnegative,
        not all zero.
    beam_width
        Partial plans that the search keeps at each step; more find better plans and tighter bounds.
    iterations
        Descents of the prices for each of two sizes of memory; more tighten the bound. With 0 both the plan
        and the bound rely on the search alone.

    Returns
    -------
    Plans
        Actions int64 (n, horizon), returns float64 (n, 4) and upper bounds float64 (n,). Nothing is random,
        but of equally good plans another machine may find another, for their bounds differ by rounding
        errors. Only components with a positive weight are pursued.

    Raises
    ------
    ValueError
        If the starts are no states of Delivery or another argument is not as described.
    """
    planes = _require_starts(starts)
    scalarisation = require_weights(weights, _COMPONENTS)
    horizon = require_integer("horizon", horizon, 0, "at least 0")
    beam_width = require_integer("beam_width", beam_width, 1, "at least 1")
    iterations = require_integer("iterations", iterations, 0, "at least 0")
    actions = np.empty((len(planes), horizon), dtype=np.int64)
    bounds = np.empty(len(planes))
    for i, start in enumerate(planes):
        actions[i], bounds[i] = _plan_one(_Task(start, horizon, scalarisation), beam_width, iterations)
    returns = replay(planes, actions)
    return Plans(actions, returns, np.maximum(bounds, returns @ scalarisation))


def replay(starts: ArrayLike, actions: ArrayLike) -> NDArray[np.float64]:
    """Let the engine step through the actions.

    Parameters
    ----------
    starts
        As in :func:`plan`.
    actions
        Delivery's actions, integers of shape (n, steps).

    Returns
    -------
    float64 array of shape (n, 4)
        The return of each reward component.

    Raises
    ------
    ValueError
        If the starts are no states of Delivery, or the actions none of its actions or of another shape.
    """
    planes = _require_starts(starts)
    sequences = np.asarray(actions)
    if sequences.ndim != 2 or len(sequences) != len(planes):
        raise ValueError(f"actions has shape {sequences.shape}; it must be ({len(planes)}, steps)")
    engine = _engine_at(planes)
    returns = np.zeros((len(planes), len(_COMPONENTS)))
    for step_actions in sequences.T:
        returns += engine.step(step_actions).rewards[:, 0]
    return returns


def _engine_at(planes: NDArray[np.uint8]) -> Engine:
    """Return an engine whose environments are in the given states, uint8 (n, 6, height, width)."""
    n, _, height, width = planes.shape
    # The counts say what a reset places; here nothing is reset.
    engine = Engine(delivery_v0.world(height, width, 0, 0, 0, 0), n)
    flat = planes.reshape(n, _NUM_PLANES, height * width)
    contents = np.where(flat[:, 0] == 1, WALL, FREE)
    for kind in range(len(_COMPONENTS)):
        contents[flat[:, 2 + kind] == 1] = FIRST_OBJECT + kind
    # The engine keeps agents apart from the other planes.
    without_agents = flat.copy()
    without_agents[:, 1] = 0
    state = engine.state_dict()
    state["planes"] = without_agents.ravel()
    state["contents"] = (contents * NUM_ACTIONS).astype(np.uint8)
    state["cells"] = flat[:, 1].argmax(axis=1)[:, None]
    engine.load_state_dict(state)
    return engine


class _Task:
    """One start, with flat cells. Its items are the objects worth collecting, then the vases worth sparing.

    Attributes
    ----------
    horizon, start : int
        Steps to plan for, and the agent's cell.
    num_objects, nothing : int
        Items below `num_objects` are objects, the others below `nothing` vases; `nothing` stands for no item.
    counts, amounts : sequences of length 4
        How many items of each kind there are, and what taking one adds to the scalarised return.
    worth : float64 array of shape (nothing + 1,)
        The same for each item; taking means collecting or breaking it.
    goes, takes : int64 arrays of shape (NUM_ACTIONS, cells)
        The cell where an action in a cell leads, and the item that it takes as long as the item is there.
    cells : int64 array
        Cells that the agent can get to.
    tolerance : float
        Differences below it are rounding errors.
    """

    def __init__(self, start: NDArray[np.uint8], horizon: int, weights: NDArray[np.float64]) -> None:
        width = start.shape[2]
        walls, agent, *kinds = start.reshape(_NUM_PLANES, -1)
        self.horizon = horizon
        self.start = int(agent.argmax())
        self.tolerance = _TOLERANCE * float(weights.max())
        self.vase_weight = float(weights[_VASE])

        # What has no weight is as good as not there.
        cells_of_kinds = [
            np.flatnonzero(kind * (weight > 0)) for kind, weight in zip(kinds, weights, strict=True)
        ]
        item_cells = np.concatenate(cells_of_kinds)
        self.counts = [len(cells) for cells in cells_of_kinds]
        self.amounts = np.append(weights[:_VASE], -weights[_VASE])
        self.nothing = len(item_cells)
        self.num_objects = self.nothing - self.counts[_VASE]
        self.worth = np.append(np.repeat(self.amounts, self.counts), 0.0)

        item_at = np.full(walls.size, self.nothing)
        item_at[item_cells] = np.arange(self.nothing)
        self.goes = np.repeat(np.arange(walls.size)[None], NUM_ACTIONS, axis=0)
        self.takes = np.full(self.goes.shape, self.nothing)
        free = np.flatnonzero(walls == 0)
        for direction, offset in enumerate((-width, width, -1, 1)):
            interact = WAIT + 1 + direction
            touched = item_at[free + offset]
            is_object = touched < self.num_objects
            self.goes[direction, free] = np.where(walls[free + offset], free, free + offset)
            self.takes[direction, free] = np.where(is_object, self.nothing, touched)
            self.takes[interact, free] = np.where(is_object, touched, self.nothing)
        self.cells = self._reachable()

    def _reachable(self) -> NDArray[np.int64]:
        reached = np.array([self.start])
        while True:
            grown = np.unique(self.goes[:, reached])
            if len(grown) == len(reached):
                return reached
            reached = grown

    def nearby(self) -> NDArray[np.bool_]:
        """Which objects touch which cell: shape (cells, nothing + 1)."""
        near = np.zeros((self.goes.shape[1], self.nothing + 1), dtype=np.bool_)
        for taken in self.takes[WAIT + 1 :]:
            near[np.arange(len(near)), taken] = True
        near[:, self.nothing] = False
        return near


class _Sums:
    """The scalarised returns, from 0 on, that any numbers of collected objects and broken vases add up to."""

    def __init__(self, task: _Task) -> None:
        self._tolerance = task.tolerance
        self._sums: NDArray[np.float64] | None = np.zeros(1)
        for count, amount in zip(task.counts, task.amounts, strict=True):
            numbers = np.arange(min(count, task.horizon) + 1)
            if self._sums.size * numbers.size > _MAX_SUMS:
                self._sums = None
                break
            sums = np.unique(self._sums[:, None] + amount * numbers)
            self._sums = sums[sums >= 0]

    def round_down(self, bound: float) -> float:
        """Return the greatest return that `bound` allows."""
        if self._sums is None:
            return bound + self._tolerance
        return float(self._sums[np.searchsorted(self._sums, bound + self._tolerance, side="right") - 1])

    def to_improve(self, value: float) -> float:
        """Return the least bound that allows a return above `value`."""
        if self._sums is None:
            return value + self._tolerance
        above = np.searchsorted(self._sums, value + self._tolerance, side="right")
        return float(self._sums[above]) - self._tolerance if above < len(self._sums) else np.inf


class _Relaxation:
    """Relaxed plans: cells remember few of the objects collected, and only the first vase costs.

    Its states are cells with the subsets of what they remember; with vases to spare, all of these twice, the
    second time with a vase broken.

    Parameters
    ----------
    task
        What is relaxed.
    memory : bool array of shape (cells, nothing + 1)
        Which objects each cell remembers, at least those that touch it.

    Attributes
    ----------
    start : int
        The state at the start.
    cell : int64 array of shape (states,)
        The cell of each state.
    leads : int64 array of shape (NUM_ACTIONS, states)
        The state that follows each action.
    takes : int64 array of shape (NUM_ACTIONS, states)
        The item that counts as taken.
    """

    def __init__(self, task: _Task, memory: NDArray[np.bool_]) -> None:
        self.task = task
        remembered = memory[task.cells]
        counts = remembered.sum(axis=1)
        sizes = 1 << counts
        self._first = np.zeros(len(memory), dtype=np.int64)
        self._first[task.cells] = np.cumsum(sizes) - sizes
        rows, objects = np.nonzero(remembered)
        places = np.arange(len(rows)) - (np.cumsum(counts) - counts)[rows]
        self._bits = np.arange(max(1, int(counts.max())))
        self._remembered = np.full((len(memory), len(self._bits)), task.nothing)
        self._remembered[task.cells[rows], places] = objects

        cell = np.repeat(task.cells, sizes)
        states = np.arange(len(cell))
        taken = np.zeros((len(cell), task.nothing + 1), dtype=np.bool_)
        subset = (states - self._first[cell])[:, None] >> self._bits & 1
        taken[states[:, None], self._remembered[cell]] = subset
        taken[:, task.nothing] = False

        takes = task.takes[:, cell]
        takes[taken[states, takes]] = task.nothing
        leads = np.repeat(states[None], NUM_ACTIONS, axis=0)
        for move in range(NUM_MOVES):
            leads[move] = self._states_without_vases(task.goes[move, cell], taken)
        for interact in range(WAIT + 1, NUM_ACTIONS):
            able = np.flatnonzero(takes[interact] < task.nothing)
            after = taken[able]
            after[np.arange(len(able)), takes[interact, able]] = True
            leads[interact, able] = self._states_without_vases(cell[able], after)

        self._unbroken = len(cell)
        if task.num_objects < task.nothing:
            breaks = (takes >= task.num_objects) & (takes < task.nothing)
            leads = np.concatenate([leads + self._unbroken * breaks, leads + self._unbroken], axis=1)
            takes = np.concatenate([takes, np.where(breaks, task.nothing, takes)], axis=1)
            cell = np.concatenate([cell, cell])
        self.cell, self.leads, self.takes = cell, leads, takes
        # The first subset of a cell is the empty one.
        self.start = int(self._first[task.start])
        self._breaking = np.flatnonzero(takes[:NUM_MOVES] < task.nothing)
        # Few states have something to collect in a given direction.
        self._collecting = []
        for interact in range(WAIT + 1, NUM_ACTIONS):
            able = np.flatnonzero(takes[interact] < task.nothing)
            self._collecting.append((able, leads[interact, able], takes[interact, able]))

    def states(self, cells: NDArray[np.int64], taken: NDArray[np.bool_]) -> NDArray[np.int64]:
        """Find the states for cells (b,) and the items taken so far (b, nothing + 1)."""
        states = self._states_without_vases(cells, taken)
        broken = taken[:, self.task.num_objects : self.task.nothing].any(axis=1)
        return states + self._unbroken * broken.astype(np.int64)

    def _states_without_vases(self, cells: NDArray[np.int64], taken: NDArray[np.bool_]) -> NDArray[np.int64]:
        bits = taken[np.arange(len(cells))[:, None], self._remembered[cells]]
        states: NDArray[np.int64] = self._first[cells] + (bits << self._bits).sum(axis=1)
        return states

    def values(self, prices: NDArray[np.float64]) -> NDArray[np.float64]:
        """Compute what relaxed plans come to after prices: (horizon + 1, states), by the steps left."""
        horizon, worth = self.task.horizon, self.task.worth - prices
        moves = self.leads[:NUM_MOVES]
        collecting = [(states, leads, worth[takes]) for states, leads, takes in self._collecting]
        values = np.zeros((horizon + 1, len(self.cell)))
        after_moves = np.empty(moves.shape)
        for before, now in pairwise(values):
            before.take(moves, out=after_moves, mode="clip")
            after_moves.reshape(-1)[self._breaking] -= self.task.vase_weight
            after_moves.max(axis=0, out=now)
            np.maximum(now, before, out=now)
            for states, leads, reward in collecting:
                now[states] = np.maximum(now[states], before[leads] + reward)
        return values

    def best_plan(
        self, values: NDArray[np.float64], prices: NDArray[np.float64]
    ) -> tuple[list[int], list[int]]:
        """Follow the values from the start; returns the states after each step and the items taken in it."""
        worth = self.task.worth - prices
        state, states, items = self.start, [], []
        for before in values[-2::-1]:
            takes, leads = self.takes[:, state], self.leads[:, state]
            action = (worth[takes] + before[leads]).argmax()
            state = int(leads[action])
            states.append(state)
            items.append(int(takes[action]))
        return states, items


class _Dual:
    """Prices on their way down to the least bound.

    Attributes
    ----------
    bound : float
        The least bound so far.
    prices : float64 array of shape (nothing + 1,)
        The prices that gave it.
    repeats : list of (int, int64 array)
        What the best relaxed plans collected twice, and the cells from the first to the second time.
    """

    def __init__(self, task: _Task) -> None:
        self._task = task
        self._current = np.zeros(task.nothing + 1)
        self._current[: task.num_objects] = task.worth[: task.num_objects] / 2
        self._direction = np.zeros(task.num_objects)
        self._scale = 1.0
        self._failures = 0
        self.bound = np.inf
        self.prices = self._current
        self.repeats: list[tuple[int, NDArray[np.int64]]] = []

    def descend(self, relaxation: _Relaxation, target: float) -> None:
        """Step along a deflected subgradient, by Polyak's rule with `target` for the least bound."""
        task, prices = self._task, self._current
        values = relaxation.values(prices)
        states, items = relaxation.best_plan(values, prices)
        bound = float(values[-1, relaxation.start] + prices.sum())
        self._failures += 1
        if bound < self.bound:
            if bound < self.bound - 1e-4 * task.worth.max():
                self._failures = 0
            self.bound, self.prices = bound, prices
        if self._failures == 5:
            self._scale *= 0.7
            self._failures = 0
        self._remember(relaxation.cell[states], items)

        objects = slice(0, task.num_objects)
        collected = np.bincount(items, minlength=task.nothing + 1)[objects]
        subgradient = 1.0 - collected
        # A price above the object's worth, or below 0, never tightens the bound.
        worth = task.worth[objects]
        subgradient[(prices[objects] <= 0) & (subgradient > 0)] = 0
        subgradient[(prices[objects] >= worth) & (subgradient < 0)] = 0
        self._direction = 0.6 * self._direction + 0.4 * subgradient
        length = float(self._direction @ self._direction)
        if length > 0:
            step = self._scale * max(bound - target, 0.05 * float(worth.max())) / max(length, 1e-3)
            self._current = prices.copy()
            self._current[objects] = np.clip(prices[objects] - step * self._direction, 0, worth)

    def _remember(self, cells: NDArray[np.int64], items: list[int]) -> None:
        seen: dict[int, int] = {}
        for step, item in enumerate(items):
            if item < self._task.num_objects:
                if item in seen:
                    self.repeats.append((item, np.unique(cells[seen[item] : step + 1])))
                seen[item] = step

    def grow(self, memory: NDArray[np.bool_], limit: int) -> bool:
        """Let cells remember what was collected twice, at most `limit` objects each; says if one does."""
        grown = False
        for item, cells in sorted(self.repeats, key=lambda repeat: len(repeat[1])):
            new = cells[~memory[cells, item]]
            if new.size and (memory[new].sum(axis=1) < limit).all():
                memory[new, item] = True
                grown = True
        self.repeats.clear()
        return grown


class _Found(NamedTuple):
    """What a search came to."""

    value: float
    """The scalarised return of the best plan."""
    actions: NDArray[np.int64]
    """That plan, shape (horizon,)."""
    cut: float
    """The highest bound of what did not fit into the beam."""


def _search(
    relaxation: _Relaxation, prices: NDArray[np.float64], sums: _Sums, known: _Found, width: int
) -> _Found:
    """Look for a better plan than the known one, with at most `width` partial plans at each step."""
    task = relaxation.task
    values = relaxation.values(prices)
    item_words = _packed(np.eye(task.nothing + 1, dtype=np.bool_))
    item_words[task.nothing] = 0

    cells = np.array([task.start])
    taken = np.zeros((1, task.nothing + 1), dtype=np.bool_)
    states = np.array([relaxation.start])
    returns = np.zeros(1)
    # Bound of a partial plan: these, and the relaxed value to go.
    refunds = np.array([prices.sum()])
    actions = np.array([WAIT])

    best, best_step, best_row, cut = known.value, -1, 0, -np.inf
    history: list[tuple[NDArray[np.int64], NDArray[np.int64]]] = []
    for step in range(task.horizon):
        goes, takes = task.goes[:, cells], task.takes[:, cells]
        takes[taken[np.arange(len(cells)), takes]] = task.nothing
        # An optimal plan need neither wait nor undo a move that brought nothing.
        useful = (goes != cells) | (takes < task.nothing)
        useful &= _UNDOES[actions] != np.arange(NUM_ACTIONS)[:, None]
        actions, parents = np.nonzero(useful)
        items = takes[actions, parents]
        refunds = refunds[parents] + (task.worth - prices)[items]
        bounds = refunds + values[task.horizon - step - 1, relaxation.leads[actions, states[parents]]]
        kept = np.flatnonzero(bounds >= sums.to_improve(best))
        if not kept.size:
            break
        words = _packed(taken)[parents[kept]] | item_words[items[kept]]
        kept = kept[_distinct(goes[actions[kept], parents[kept]], words)]
        if kept.size > width:
            order = np.argpartition(-bounds[kept], width)
            cut = max(cut, float(bounds[kept[order[width]]]))
            kept = kept[order[:width]]
        actions, parents, items, refunds = actions[kept], parents[kept], items[kept], refunds[kept]
        cells = goes[actions, parents]
        returns = returns[parents] + task.worth[items]
        taken = taken[parents]
        taken[np.arange(len(kept)), items] = True
        taken[:, task.nothing] = False
        states = relaxation.states(cells, taken)
        history.append((actions, parents))
        row = int(returns.argmax())
        if returns[row] > best + task.tolerance:
            best, best_step, best_row = float(returns[row]), step, row

    if best_step < 0:
        return known._replace(cut=cut)
    sequence = np.full(task.horizon, WAIT, dtype=np.int64)
    for step in reversed(range(best_step + 1)):
        actions, parents = history[step]
        sequence[step], best_row = actions[best_row], parents[best_row]
    return _Found(best, sequence, cut)


def _packed(taken: NDArray[np.bool_]) -> NDArray[np.uint64]:
    """Pack the items taken, (b, nothing + 1), into the bits of words, (b, m)."""
    room = -taken.shape[1] % 64
    return np.packbits(np.pad(taken, ((0, 0), (0, room))), axis=1).view(np.uint64)


def _distinct(cells: NDArray[np.int64], words: NDArray[np.uint64]) -> NDArray[np.int64]:
    """Find one index of each different pair of cell (b,) and packed items (b, m)."""
    order = np.lexsort((cells, *words.T))
    cells, words = cells[order], words[order]
    new = np.ones(len(order), dtype=np.bool_)
    new[1:] = (cells[1:] != cells[:-1]) | (words[1:] != words[:-1]).any(axis=1)
    return order[new]


def _plan_one(task: _Task, beam_width: int, iterations: int) -> tuple[NDArray[np.int64], float]:
    """Return actions (horizon,) and an upper bound of the scalarised return for one start."""
    sums = _Sums(task)
    memory = task.nearby()
    relaxation = _Relaxation(task, memory)
    dual = _Dual(task)
    best = _Found(0.0, np.full(task.horizon, WAIT, dtype=np.int64), np.inf)
    bound = np.inf

    def look(width: int) -> bool:
        """Search, and say whether that leaves nothing to improve."""
        nonlocal best, bound
        best = _search(relaxation, dual.prices, sums, best, width)
        searched = max(best.value, sums.round_down(best.cut)) if best.cut > -np.inf else best.value
        bound = min(bound, searched)
        return bound <= best.value + task.tolerance

    if look(min(_NARROW, beam_width)):
        return best.actions, bound
    for limit in _MEMORY_LIMITS:
        for done in range(0, iterations, _SWEEP):
            for _ in range(min(_SWEEP, iterations - done)):
                dual.descend(relaxation, best.value)
            if look(min(_NARROW, beam_width)):
                return best.actions, bound
            if dual.grow(memory, limit):
                relaxation = _Relaxation(task, memory)
        if look(beam_width) or not iterations:
            break
    return best.actions, min(bound, sums.round_down(dual.bound))


def _require_starts(starts: ArrayLike) -> NDArray[np.uint8]:
    """Return the starts as uint8 (n, 6, height, width) if they are states of Delivery, else raise."""
    planes = require_planes(starts, _NUM_PLANES)
    walls, agents, *objects = np.moveaxis(planes, 1, 0)
    refuse_first(agents.sum(axis=(1, 2)) != 1, "no or several agents", "exactly one")
    refuse_first((agents & walls).any(axis=(1, 2)), "its agent in a wall", "it on a free cell")
    crowded = (sum(objects, walls) > 1).any(axis=(1, 2))
    refuse_first(crowded, "several things in a cell", "at most one wall or object in each")
    return planes
