"""How fast a machine is taken to be."""

import pytest

from sira_assets.plan.machine import _usual


def usual_of(seconds):
    """What counts of repeats that take these seconds; the first, which allocates, is not among them."""
    now, left = 0.0, iter([9.0, *seconds])

    def work():
        nonlocal now
        now += next(left)

    return _usual(work, len(seconds), lambda: now)


def test_hiccups_do_not_count_however_long_they_last():
    assert usual_of([1.0, 1.0, 1.0, 1.0, 5.0, 5.0, 5.0, 5.0, 5.0]) == pytest.approx(1.0)


def test_a_machine_that_others_use_counts_as_it_is():
    assert usual_of([2.0] * 9) == pytest.approx(2.0 * usual_of([1.0] * 9))
