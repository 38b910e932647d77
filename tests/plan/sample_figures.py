"""A sweep as it could be: two fits that shorten with their steps, maps that grow with their size."""

from sira_assets.plan.figures import Benchmark, Figures, KnobCurve, Point, StageCost

BENCH = Benchmark(0.02, 0.03, 0.05)
STEPS = (0.06, 0.125, 0.25, 0.5, 1.0, 2.0)


def points(values, stage, exponent, measure, losses, memory=10**9):
    """Points whose cost is a power of the value, relative to 1."""
    return tuple(
        Point(v, ((stage, float(v) ** exponent),), ((measure, loss),), (), memory)
        for v, loss in zip(values, losses, strict=True)
    )


def figures() -> Figures:
    """The sweep."""
    steps = (0.5, 0.3, 0.15, 0.05, 0.0, -0.02)
    sizes = (256, 512, 1024, 2048)
    bake = tuple(
        Point(s, (("bake", (s / 1024) ** 2), ("write", s / 1024)), (("bake_rms", rms),), (), 10**9 + 700 * s * s)
        for s, rms in zip(sizes, (8.0, 3.0, 0.0, -3.0), strict=True)
    )
    return Figures(
        "by hand",
        scenes=1,
        seeds=1,
        threads=1,
        benchmark=BENCH,
        reference=(
            StageCost("start", 5.0, 10**9),
            StageCost("fit geometry", 50.0, 10**9),
            StageCost("fit appearance", 60.0, 10**9),
            StageCost("unwrap", 6.0, 10**9),
            StageCost("bake", 20.0, 2 * 10**9),
            StageCost("write", 8.0, 10**9),
        ),
        accuracy=(("face_mm", 1.3), ("diffuse_db", 20.0), ("bake_rms", 3.0)),
        spread=(("face_mm", 0.05),),
        curves=(
            KnobCurve("geometry steps", points(STEPS, "fit geometry", 1.0, "face_mm", steps)),
            # Decibels: what is worse by.
            KnobCurve("appearance steps", points(STEPS, "fit appearance", 1.0, "diffuse_db", [6 * s for s in steps])),
            KnobCurve("texture size", bake),
        ),
    )
