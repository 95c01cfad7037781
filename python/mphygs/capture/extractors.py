"""Feature extractors by their names."""

from __future__ import annotations

from pathlib import Path

from mphygs.capture.features import ColourFeatures, FeatureExtractor, JoinedFeatures
from mphygs.capture.features_dino import DinoFeatures
from mphygs.capture.features_xfeat import XFeatFeatures

_COLOUR_WEIGHT, _NETWORK_WEIGHT = 1.0, 0.5
Extractor = FeatureExtractor | JoinedFeatures


def extractor_of(text: str) -> Extractor:
    """The extractor of a name: colour, xfeat, dino:FOLDER, or several with a plus between them.

    Raises ValueError for names that there are not, CaptureError for what is not installed or not there.
    """
    found: list[FeatureExtractor] = []
    for kind, folder in feature_names(text):
        if kind == "colour":
            found.append(ColourFeatures())
        elif kind == "xfeat":
            found.append(XFeatFeatures())
        else:
            found.append(DinoFeatures.of(folder))
    if len(found) == 1:
        return found[0]
    weights = tuple(_COLOUR_WEIGHT if isinstance(e, ColourFeatures) else _NETWORK_WEIGHT for e in found)
    return JoinedFeatures(tuple(found), weights)


def feature_names(text: str) -> list[tuple[str, Path]]:
    """Kind and folder of every extractor in a name; only those of dino have a folder. Raises ValueError."""
    found = []
    for name in text.split("+"):
        kind, _, folder = name.strip().partition(":")
        if kind not in ("colour", "xfeat", "dino") or (kind == "dino") != bool(folder):
            raise ValueError(f"got '{text}'; expected colour, xfeat, dino:FOLDER, or several with +")
        found.append((kind, Path(folder)))
    if len(set(found)) < len(found):
        raise ValueError(f"got '{text}'; expected each only once")
    return found
