"""A prior whose networks have learnt nothing: the reference is a ball of ten centimetres."""

import torch

from sira_assets.fields.af_sm import AppearanceConfig, AppearanceFactorModel
from sira_assets.fields.prior import CodeStatistics, Prior, freeze
from sira_assets.fields.sa_sm import ShapeAppearanceModel, ShapeConfig

SHAPE = ShapeConfig(code_size=4, appearance_code_size=4, feature_size=2, deformation_width=16, reference_width=16)
APPEARANCE = AppearanceConfig(albedo_code_size=3, specular_code_size=2, light_code_size=3, lobes=4, albedo_width=16)


def ball_prior() -> Prior:
    """The same one at every call."""
    torch.manual_seed(3)
    shape, appearance = ShapeAppearanceModel(SHAPE), AppearanceFactorModel(APPEARANCE, feature_size=2)
    torch.nn.init.normal_(shape.reference.out.weight, std=1e-3)
    statistics = [CodeStatistics.of(0.1 * torch.randn(12, size)) for size in (4, 4, 3, 2, 3)]
    return Prior(freeze(shape), freeze(appearance), *statistics)
