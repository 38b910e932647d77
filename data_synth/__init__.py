"""Procedural head scans with exact geometry, material and light: what trains and measures the models."""
