"""Whether fits are as good on any skin: each geometry, pose and light in three tones, everything else the same.

Notation: a tone is a melanin fraction at 10, 50 and 90 % of the generator's population; the light is exposed for the
middle one, so that the three pictures of a person are lit by the same lamps to the bit.
"""

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from _fit_measurement import Scene, face_errors, fit_material, fit_shape, rendered

# Shares of the population below it; melanin is log-uniform over MELANIN_OF_DARK there.
TONES = {"light": 0.1, "middle": 0.5, "dark": 0.9}
# No tone may be worse than the best by more.
MOST_WORSE = 0.15


def melanin_of(share: float) -> float:
    """Melanin fraction below which this share of the population is."""
    from data_synth.head.cover_sampling import MELANIN_OF_DARK

    low, high = MELANIN_OF_DARK
    return float(low * (high / low) ** share)


def write_tones(out: Path, indices: range, *, size: int, samples: int, seed: int) -> list[tuple[int, str, Path]]:
    """Scenes of every head in every tone, those that are missing drawn now: (head, tone, folder)."""
    from data_synth.draw_scene import draw_scene
    from data_synth.scene_settings import SceneSettings
    from data_synth.subject import SkinTone
    from data_synth.write_scene import write_scene

    settings = SceneSettings(kind="eval", seed=seed, views=1, size=size, samples=samples)
    found = []
    for index in indices:
        for tone, share in TONES.items():
            folder = out / f"head_{index:03d}_{tone}_{size}px_{samples}_seed{seed}"
            if not folder.is_dir():
                skin = SkinTone(melanin_of(share), metered=melanin_of(TONES["middle"]))
                write_scene(draw_scene(settings, index, tone=skin), folder)
            found.append((index, tone, folder))
    return found


def measure_tone(scene: Scene, prior, settings) -> dict[str, object]:
    """Face error (mm), and error of the skin's albedo over its mean: albedo as it is, albedo_one_gain after a gain."""
    shape = fit_shape(scene.portrait, prior, settings)
    appearance, seconds = fit_material(shape, prior, settings)
    errors = face_errors(shape, scene)
    view = rendered(shape, appearance, shape.portrait.camera, appearance.light, shadows=False)
    skin = skin_pixels(scene) & view.hit
    out = {name: errors[name] for name in ("placed", "after_icp")} | albedo_error(view.diffuse, scene.folder, skin)
    return out | {"seconds": sum(shape.seconds.values()) + sum(seconds.values())}


def skin_pixels(scene: Scene) -> np.ndarray:
    """(H, W) bool: bare skin and lips, by the scene's true regions."""
    import json

    from PIL import Image

    gt = scene.folder / "gt"
    names = json.loads((gt / "regions.json").read_text())
    wanted = [int(number) for number, name in names.items() if name in ("skin", "lips")]
    with Image.open(gt / "regions" / "000.png") as file:
        return np.isin(np.asarray(file), wanted) & scene.portrait.mask


def albedo_error(ours: np.ndarray, folder: Path, skin: np.ndarray) -> dict[str, float]:
    """Mean absolute error of the linear albedo over its mean, inside `skin`."""
    from sira_assets.measure.image_metrics import best_gain
    from sira_assets.scene.image import read_image

    true = read_image(folder / "gt" / "albedo.exr").linear
    error = lambda gain: float(np.abs(gain * ours - true)[skin].mean() / true[skin].mean())  # noqa: E731
    return {
        "albedo": error(1.0),
        "albedo_one_gain": error(best_gain(ours, true, skin)),
        "true_albedo": float(true[skin].mean()),
        "skin_pixels": int(skin.sum()),
    }


def print_fairness(rows: list[Mapping[str, object]]) -> None:
    """Means by tone, and how much worse the worst is than the best."""
    from _fit_measurement import mean_of, print_table

    names = ("placed", "after_icp", "albedo", "albedo_one_gain", "true_albedo", "seconds")
    by_tone = {tone: [row for row in rows if row["tone"] == tone] for tone in TONES}
    print_table(["tone", "heads", *names], [[t, len(r), *(mean_of(r, n) for n in names)] for t, r in by_tone.items()])
    for name in names[:4]:
        means = [mean_of(row, name) for row in by_tone.values()]
        worse = max(means) / min(means) - 1.0
        verdict = "within" if worse <= MOST_WORSE else "over"
        print(f"{name}: worst tone {100 * worse:.1f} % above the best ({verdict} {100 * MOST_WORSE:.0f} %)")
