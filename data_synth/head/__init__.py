"""Procedural heads: shape, hair and material, exact at every point of the template."""
