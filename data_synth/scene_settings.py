"""What the scenes of one data set have in common, and how one is named.

Notation: a scene is a function of its settings and its index alone. `train` and `eval` heads are drawn from disjoint
spaces of random streams; `scan` scenes show one head of the user's own.
"""

from dataclasses import asdict, dataclass
from functools import lru_cache
from hashlib import sha256
from pathlib import Path

import numpy as np

from data_synth.render import RenderConfig
from data_synth.scan_mesh import ScanMesh, read_scan_mesh
from data_synth.scene_light import PanoramaFile
from sira_assets.errors import InputError

KINDS = ("train", "eval", "scan")
TRUTHS = ("full", "train")
# Everything that a scene's bytes depend on, beside the libraries: these folders' sources and data.
SOURCES = ("data_synth", "sira_assets/numerics", "sira_assets/scene", "sira_assets/mesh")


@dataclass(frozen=True)
class ScanSource:
    """A head of the user's own, in files.

    Parameters
    ----------
    name : letters, digits, `-` and `_`; scenes are called after it
    mesh, landmarks, texture : paths; no texture where the mesh names its own or has vertex colours
    metres_per_unit : length of the mesh's unit; None sizes the head by its landmarks as the mean head
    pieces : "all" keeps every piece but dust, "largest" one
    """

    name: str
    mesh: str
    landmarks: str
    texture: str | None = None
    metres_per_unit: float | None = None
    pieces: str = "all"

    @lru_cache(maxsize=2)  # noqa: B019 - hashes by value, a few strings each
    def read(self) -> ScanMesh:
        """The mesh, cleaned; read once a process.

        Raises
        ------
        InputError : as `read_scan_mesh`.
        """
        return read_scan_mesh(self.mesh, self.texture, pieces=self.pieces)

    @lru_cache(maxsize=8)  # noqa: B019 - hashes by value, a few strings each
    def digest(self) -> str:
        """SHA-256 of what the files hold, those that the mesh names too, and of what is done to it; hexadecimal."""
        total = sha256(f"{self.metres_per_unit} {self.pieces} {self.read().digest()}".encode())
        total.update(sha256(Path(self.landmarks).read_bytes()).digest())
        return total.hexdigest()


@dataclass(frozen=True)
class SceneSettings:
    """What a data set's scenes have in common: views, size in pixels, light samples and sub-pixel samples.

    `truth`: "full" writes all that is known, "train" only what training reads. `crops`, `occluders`: shares of scenes
    whose picture cuts the head, or where something is held before it. `panoramas`: light every scene by one of these.
    """

    kind: str = "train"
    seed: int = 0
    views: int = 8
    size: int = 256
    samples: int = 64
    supersample: int = 1
    truth: str = "full"
    scan: ScanSource | None = None
    crops: float = 0.0
    occluders: float = 0.0
    panoramas: tuple[PanoramaFile, ...] = ()

    def __post_init__(self):
        RenderConfig(self.samples, self.supersample)
        if self.kind not in KINDS or self.views < 1 or self.size < 16 or self.seed < 0 or self.truth not in TRUTHS:
            raise InputError(
                expected=f"kind among {', '.join(KINDS)}, truth among {', '.join(TRUTHS)}, views >= 1, size >= 16, "
                "seed >= 0",
                received=f"kind {self.kind}, truth {self.truth}, views {self.views}, size {self.size}, "
                f"seed {self.seed}",
                remedy="choose such values",
            )
        if not (0.0 <= self.crops <= 1.0 and 0.0 <= self.occluders <= 1.0):
            raise InputError(
                expected="shares of crops and occluders between 0 and 1",
                received=f"crops {self.crops}, occluders {self.occluders}",
                remedy="choose such shares",
            )
        if (self.kind == "scan") != (self.scan is not None):
            raise InputError(expected="a scan for kind scan, and for no other", received=self.kind, remedy="give one")

    def named(self) -> str:
        """What scenes and the settings' file are called after."""
        return self.kind if self.scan is None else self.scan.name

    def stream(self, index: int) -> np.random.SeedSequence:
        """The root of scene `index`'s randomness."""
        key = (KINDS.index(self.kind), index)
        if self.scan is not None:
            key = (*key, int(self.scan.digest()[:8], 16))
        return np.random.SeedSequence(self.seed, spawn_key=key)

    def described(self) -> dict:
        """The settings for a file, without paths of this machine; equal descriptions give equal scenes."""
        out = asdict(self) | {"generator": generator_fingerprint()}
        out["panoramas"] = [panorama.described() for panorama in self.panoramas]
        if self.scan is None:
            del out["scan"]
        else:
            out["scan"] = {
                "name": self.scan.name,
                "file": Path(self.scan.mesh).name,
                "sha256": self.scan.digest(),
                "metres_per_unit": self.scan.metres_per_unit,
                "pieces": self.scan.pieces,
            }
        return out


def scene_name(settings: SceneSettings, index: int) -> str:
    """The folder of a scene."""
    return f"{settings.named()}_{index:06d}"


@lru_cache(maxsize=1)
def generator_fingerprint() -> str:
    """Twelve hexadecimal digits over the generator's own sources and data: another generator, other digits."""
    root = Path(__file__).resolve().parents[1]
    total = sha256()
    for folder in SOURCES:
        for path in sorted((root / folder).rglob("*")):
            if path.suffix in (".py", ".json", ".npz"):
                total.update(path.relative_to(root).as_posix().encode() + b"\0" + sha256(path.read_bytes()).digest())
    return total.hexdigest()[:12]
