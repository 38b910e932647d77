"""One portrait photo in, one relightable 3D head avatar out.

The rooms, each importing only those before it: numerics, scene, fields, mesh, render, train, fit, texture, asset,
relight, viewer, measure, pipeline, plan, delivery. `sira_assets.pipeline.run` is the whole journey.
"""

__version__ = "0.1.0"
