"""What dominates what, monotone and convex curves, and knees: known answers."""

import numpy as np
import pytest

from sira_assets.plan.front import convex_steps, dominated, knee, monotone


def test_dominated_on_a_small_case():
    # b costs more than a and is no better anywhere; c pays for what it is better in; d equals a.
    costs = [1.0, 2.0, 3.0, 1.0]
    losses = [[5.0, 5.0], [5.0, 6.0], [9.0, 1.0], [5.0, 5.0]]
    assert dominated(costs, losses).tolist() == [False, True, False, False]
    # Better by less than the noise is not better.
    assert dominated(costs, losses, noise=np.array([0.0, 10.0])).tolist() == [False, True, True, False]


def test_the_front_is_never_empty_and_holds_what_no_other_beats():
    rng = np.random.default_rng(0)
    for _ in range(50):
        costs, losses = rng.random(8), rng.random((8, 2))
        bad = dominated(costs, losses)
        assert not bad[np.argmin(costs)]
        assert not bad[np.argmin(losses[:, 0])]
        for i in np.flatnonzero(bad):
            worse = (costs <= costs[i]) & (losses <= losses[i]).all(1)
            assert worse.sum() > 1  # itself and at least one other


def test_monotone_is_the_nearest_falling_sequence():
    assert monotone([5.0, 3.0, 4.0, 1.0]).tolist() == [5.0, 3.5, 3.5, 1.0]
    assert monotone([1.0, 2.0, 3.0]).tolist() == [2.0, 2.0, 2.0]
    assert monotone([1.0, 4.0], weights=[3.0, 1.0]).tolist() == [1.75, 1.75]
    assert monotone([]).tolist() == []
    rng = np.random.default_rng(1)
    values = rng.random(12)
    best = monotone(values)
    assert (np.diff(best) <= 0).all()
    assert best.mean() == pytest.approx(values.mean())
    for _ in range(200):  # no falling sequence is nearer
        other = np.sort(rng.random(12))[::-1]
        assert ((other - values) ** 2).sum() >= ((best - values) ** 2).sum() - 1e-12


def test_convex_steps_buy_less_and_less():
    costs, losses = [1.0, 2.0, 3.0, 4.0, 5.0, 6.0], [10.0, 9.0, 4.0, 3.9, 1.0, 1.5]
    assert convex_steps(costs, losses) == [0, 2, 4]
    rng = np.random.default_rng(2)
    costs, losses = rng.random(30), rng.random(30)
    chosen = convex_steps(costs, losses)
    rates = -np.diff(losses[chosen]) / np.diff(costs[chosen])
    assert (rates > 0).all()
    assert (np.diff(rates) <= 1e-12).all()
    assert chosen[0] == np.argmin(costs)
    assert chosen[-1] == np.argmin(losses)
    # Nothing lies below the hull.
    inside = (costs >= costs[chosen[0]]) & (costs <= costs[chosen[-1]])
    assert (losses[inside] >= np.interp(costs[inside], costs[chosen], losses[chosen]) - 1e-12).all()


def test_a_knee_is_where_it_was_put():
    assert knee([1, 2, 4, 8, 16], [10.0, 5.0, 1.0, 0.9, 0.8]) == 2
    assert knee([16, 8, 4, 2, 1], [0.8, 0.9, 1.0, 5.0, 10.0]) == 2  # whatever the order
    assert knee([1, 2, 4], [1.0, 1.0, 1.0]) is None  # nothing is gained
    assert knee([1, 1, 1], [3.0, 2.0, 1.0]) is None  # nothing is paid
    assert knee([1], [1.0]) is None
    assert knee([1, 2], [2.0, 1.0]) is None  # two points have no bend
    assert knee([1, 2, 4], [1.0, 0.9, 0.0]) is None  # bent the other way
