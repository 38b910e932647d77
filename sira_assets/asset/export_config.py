"""What may be chosen about the files of an avatar."""

from dataclasses import dataclass

from sira_assets.errors import InputError

SPECULAR_FORMS = ("color", "factor")


@dataclass(frozen=True)
class ExportConfig:
    """How an avatar is written; the defaults lose nothing that eight bits can hold.

    Parameters
    ----------
    specular_form : "color" writes F0 into KHR_materials_specular's colour and leaves F90 at 1; "factor" writes it into
        the extension's weight, which scales F90 as well, for programs that read only that
    quantise : vertex data of the GLB as 8 and 16-bit integers (KHR_mesh_quantization): half the size, positions to a
        65535th of the head
    jpeg_quality : pictures of the GLB, but for normals, as JPEG of that quality (1 to 100), colours not subsampled;
        None: PNG, lossless
    usd : write avatar.usdc and avatar.usdz too; needs the extra `usd`

    Raises
    ------
    InputError : another form, or a quality out of range.
    """

    specular_form: str = "color"
    quantise: bool = False
    jpeg_quality: int | None = None
    usd: bool = False

    def __post_init__(self):
        if self.specular_form not in SPECULAR_FORMS:
            raise InputError(
                expected="a specular form of color or factor",
                received=f"{self.specular_form!r}",
                remedy="choose one of the two",
            )
        if self.jpeg_quality is not None and not 1 <= self.jpeg_quality <= 100:
            raise InputError(
                expected="a JPEG quality of 1 to 100", received=f"{self.jpeg_quality}", remedy="95 is nearly lossless"
            )
