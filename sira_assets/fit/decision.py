"""A choice that a fit made by itself: rule three of this project, model only what the scene requires."""

from dataclasses import dataclass


@dataclass(frozen=True)
class FitDecision:
    """What was chosen, and the measurement that it was chosen from, each in a few words."""

    what: str
    chosen: str
    evidence: str
