"""The paper's ablations as named settings of the present models and fits.

a.1 to a.4 concern the shape, each adding one thing to the one before: codes alone; all weights fine-tuned (H3D-Net's
way); a reference and a deformation in place of one network; shape learnt jointly with appearance. b.1 to b.3 concern
the appearance, all on a.4's shape. "paper" holds SIRA's own figures, on its own data: they say the order, not the bar.
"""

from collections.abc import Callable
from dataclasses import dataclass, field, replace

from sira_assets.fields.prior import Prior, untrained_appearance
from sira_assets.fields.sa_sm import ShapeAppearanceModel, ShapeConfig
from sira_assets.fit.shading import ShadingConfig
from sira_assets.pipeline import Settings, settings_for


@dataclass(frozen=True)
class Ablation:
    """One row of the table.

    Parameters
    ----------
    prior : which of `shape_models` it is fitted with
    change : the draft settings -> its own
    blank : appearance starts untrained
    paper : figure -> SIRA's value, mm or dB
    """

    name: str
    says: str
    prior: str
    change: Callable[[Settings], Settings]
    blank: bool = False
    paper: dict[str, float] = field(default_factory=dict)

    @property
    def of_shape(self) -> bool:
        """Whether the row is about the shape."""
        return self.name.startswith("a.")

    def settings(self, seed: int) -> Settings:
        """Draft quality with this row's change, fitted as in the paper: networks opened, shading unread, no mirror."""
        draft = settings_for("draft", seed=seed)
        paper = {"steps_codes": 100, "steps_networks": 40, "steps_cover": 20}
        paper |= {"shading": ShadingConfig(steps=0), "symmetry": 0.0}
        return self.change(replace(draft, geometry=replace(draft.geometry, **paper)))

    def starting(self, prior: Prior, seed: int) -> Prior:
        """The prior as this row begins with it."""
        return untrained_appearance(prior, seed) if self.blank else prior


def _codes_only(settings: Settings) -> Settings:
    """As many steps, none of them on the networks."""
    g = settings.geometry
    steps = g.steps_codes + g.steps_networks + g.steps_cover
    return replace(settings, geometry=replace(g, steps_codes=steps, steps_networks=0, steps_cover=0))


def _at_once(settings: Settings) -> Settings:
    return replace(settings, appearance=replace(settings.appearance, scheduled=False))


def _unrefined(settings: Settings) -> Settings:
    """As many steps, none of them of the refinement."""
    a = settings.appearance
    extra = a.steps_refinement // 3
    return replace(
        settings,
        appearance=replace(
            a,
            steps_light=a.steps_light + extra,
            steps_albedo=a.steps_albedo + extra,
            steps_specular=a.steps_specular + a.steps_refinement - 2 * extra,
            steps_refinement=0,
        ),
    )


def _same(settings: Settings) -> Settings:
    return settings


# Digital Emily, dB.
EMILY = {"final": 33.4, "diffuse": 22.5, "specular": 9.91}
ABLATIONS = (
    Ablation("a.1", "codes only, no reference", "plain", _codes_only),
    Ablation("a.2", "fine-tuned, no reference (H3D-Net)", "plain", _same, paper={"face": 2.17}),
    Ablation("a.3", "reference + deformation", "deformed", _same, paper={"face": 1.86}),
    # Of its main table: the face on H3DS, from one view.
    Ablation("a.4", "all: appearance learnt jointly", "full", _same, paper={"face": 1.46}),
    Ablation("b.1", "no prior, no schedule", "full", _at_once, blank=True),
    Ablation("b.2", "prior + schedule", "full", _unrefined),
    Ablation("b.3", "prior + schedule + refinement", "full", _same, paper=EMILY),
)


def shape_models(base: ShapeConfig = ShapeConfig()) -> dict[str, ShapeConfig]:
    """The three SA-SMs, with about as many weights of the shape each."""
    full, deformed = base, replace(base, joint_appearance=False)
    wanted, width = shape_weights(full), base.deformation_width
    while True:
        plain = replace(deformed, reference=False, deformation_width=width, deformation_octaves=base.reference_octaves)
        if shape_weights(plain) >= wanted:
            return {"plain": plain, "deformed": deformed, "full": full}
        width += 4


def shape_weights(config: ShapeConfig) -> int:
    """Weights of deformation and reference together, or of the one network that replaces them."""
    model = ShapeAppearanceModel(config)
    nets = [model.deformation] if model.reference is None else [model.deformation, model.reference]
    return sum(p.numel() for net in nets for p in net.parameters())
