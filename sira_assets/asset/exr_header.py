"""What our EXR files say of themselves, in OpenEXR's standard attributes.

`chromaticities` are Rec. 709's with D65 (ITU-R BT.709-6, table 1); `colorInteropID` names the encoding by the Color
Interop Forum's list (lin_rec709_scene, or data for what is no colour); `comments` says quantity and unit. There is no
date and no host: the same avatar gives the same bytes.
"""

REC709_D65 = (0.64, 0.33, 0.30, 0.60, 0.15, 0.06, 0.3127, 0.3290)


def colour_header(comments: str) -> dict[str, object]:
    """Attributes of a picture of linear Rec. 709 values: radiance, irradiance, albedo."""
    return {**_said(comments, "lin_rec709_scene"), "chromaticities": REC709_D65}


def data_header(comments: str) -> dict[str, object]:
    """Attributes of values that are no colours, which no reader may convert: normals, F0."""
    return _said(comments, "data")


def _said(comments: str, space: str) -> dict[str, object]:
    return {"comments": comments, "colorInteropID": space, "software": "sira_assets"}
