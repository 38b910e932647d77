"""Steps of a fit's stage against the clock: a stage that must end by a moment does as many steps as it has time for.

Notation: a stage is planned with S steps; p in [0, 1) says how far along its schedule it is, so its planned step is
floor(p S). Without a clock p = n / S after n steps. With one, each step moves p on by (1 - p) / m, where m is how many
steps still fit into the time left at the speed seen so far: schedules keep their shape however many steps there are.
"""

import time
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

# Steps after which their mean time is worth going by, and how many of the last ones it is taken over: twice the 40
# steps after which a geometry fit traces its rays anew.
FEWEST = 4
WINDOW = 80


@dataclass(frozen=True)
class StageKept:
    """How many steps a stage was planned with, how many it did, and in how many seconds."""

    name: str
    planned: int
    done: int
    seconds: float


@dataclass(frozen=True)
class Pace:
    """When a fit is to be over.

    Parameters
    ----------
    ends_at : on `clock`, seconds
    most : no stage does more than this many times its planned steps
    clock : monotonic seconds
    note : told of each stage as it ends
    """

    ends_at: float
    most: float = 1.0
    clock: Callable[[], float] = time.monotonic
    note: Callable[[StageKept], None] = lambda kept: None


def stage_ends(pace: Pace, work: Sequence[float], setting_out_s: float = 0.0) -> float:
    """When the first of the stages left is to end, the time left shared out by their `work` (any unit).

    Parameters
    ----------
    setting_out_s : time that each of the stages behind it takes before its first step is done
    """
    now = pace.clock()
    share = work[0] / max(sum(work), 1e-30)
    return now + share * max(pace.ends_at - now - (len(work) - 1) * setting_out_s, 0.0)


def progress(
    steps: int, *, first: int = 0, pace: Pace | None = None, work: Sequence[float] = (1.0,)
) -> Iterator[float]:
    """p before each step of a stage; the time between two values asked for is taken as one step's.

    Parameters
    ----------
    steps : planned
    first : steps done before, without a pace only
    work : of this stage and of those behind it, see `stage_ends`; with a pace only

    Notes
    -----
    The first step is every stage's setting out (a geometry fit traces all rays in it): the time is shared out after it,
    or a short stage would be over before its second step. The stages behind are expected to take as long over theirs,
    or the last one would pay for all: in a geometry fit, the one that closes what shows no surface.
    """
    if pace is None:
        yield from (step / steps for step in range(first, steps))
        return
    if not steps:
        return
    set_out = pace.clock()
    yield 0.0
    ends_at = stage_ends(pace, work, pace.clock() - set_out)
    # The first step does what the others do now and then only (rays are traced anew), so it is left out of the mean.
    stamps = deque([pace.clock()], maxlen=WINDOW + 1)
    done, p = 1, 1.0 / steps
    while p < 1.0 and stamps[-1] < ends_at:
        yield p
        done += 1
        stamps.append(pace.clock())
        each = max((stamps[-1] - stamps[0]) / (len(stamps) - 1), 1e-9)
        left = steps - done if done <= FEWEST else min((ends_at - stamps[-1]) / each, pace.most * steps - done)
        p = 1.0 if left < 1.0 else p + (1.0 - p) / (left + 1.0)
