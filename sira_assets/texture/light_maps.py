"""Maps of the light that a surface receives and sends.

Notation: E(n) = integral of L(w) V(w) max(0, n.w) over the sphere, of the SG light alone; V, the head's own cast
shadows, is 1 where none are given. Radiance is what an eye on the normal sees: a E / pi and the specular lobe of
`render.shading` for view = n. All in the canonical frame.
"""

import numpy as np

from sira_assets.scene.sg_light import SGLight

# Normals times lobes held at once.
_AT_ONCE = 2_000_000


def light_maps(
    normals: np.ndarray,
    light: SGLight,
    visibility: np.ndarray | None,
    *,
    diffuse: np.ndarray | None = None,
    specular_f0: np.ndarray | None = None,
    roughness: float | None = None,
) -> tuple[np.ndarray, np.ndarray | None]:
    """Irradiance (N, 3), and radiance (N, 3) where both albedos are given; float32.

    Parameters
    ----------
    normals : (N, 3) unit
    light : in the frame of the normals
    visibility : (N, M) in [0, 1], or None
    roughness : of the specular lobe, 0.05 to 1; `render.shading.ROUGHNESS` if None
    """
    lit = diffuse is not None and specular_f0 is not None
    reflects = lit and bool((specular_f0 > 0).any())
    irradiance_out = np.zeros((len(normals), 3), np.float32)
    radiance = np.zeros((len(normals), 3), np.float32) if lit else None
    if not len(light):
        return irradiance_out, radiance
    import torch

    from sira_assets.numerics.sg import irradiance
    from sira_assets.render.shading import ROUGHNESS, shade

    def tensor(array: np.ndarray) -> torch.Tensor:
        return torch.tensor(array, dtype=torch.float32)

    lobes = tensor(light.axis), tensor(light.sharpness), tensor(light.amplitude)
    rough = ROUGHNESS if roughness is None else roughness
    chunk = max(1, _AT_ONCE // len(light))
    with torch.no_grad():
        for start in range(0, len(normals), chunk):
            rows = slice(start, start + chunk)
            n = tensor(normals[rows])
            seen = None if visibility is None else tensor(visibility[rows])
            if lit:
                f0 = tensor(specular_f0[rows]) if reflects else None
                shaded = shade(n, n, tensor(diffuse[rows]), f0, *lobes, roughness=rough, visibility=seen)
                irradiance_out[rows], radiance[rows] = shaded.irradiance.numpy(), shaded.radiance.numpy()
            else:
                irradiance_out[rows] = irradiance(n, *lobes, visibility=seen).numpy()
    return irradiance_out, radiance
