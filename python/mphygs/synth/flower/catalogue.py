"""Twelve species."""

from __future__ import annotations

from collections.abc import Mapping

from mphygs.synth.flower.outlines import centre, leaf, petal
from mphygs.synth.flower.paint import BladePaint, RoundPaint
from mphygs.synth.flower.species import GREEN, PALE_GREEN, LeafAt, Species, Tissue, Whorl

_DAISY = Species(
    "daisy",
    (
        Whorl(
            "petals", 12, petal(0.024, 0.0055, (18.0, 14.0, 4.0, -8.0), cup=0.001),
            BladePaint((0.86, 0.84, 0.74), (0.93, 0.93, 0.95), (0.62, 0.63, 0.70), veins=5.0),
            Tissue(2.2e5, 260.0), columns=4,
        ),
    ),
    (LeafAt(0.40, 20.0, leaf()), LeafAt(0.58, 190.0, leaf(0.026))),
    centre((0.88, 0.66, 0.10)),
    columns=60,
    receptacle=0.0095,
)  # fmt: skip
_TULIP = Species(
    "tulip",
    (
        Whorl(
            "petals", 3, petal(0.034, 0.014, (5.0, 62.0, 86.0, 92.0, 84.0), cup=0.004, rounding=0.3),
            BladePaint((0.88, 0.72, 0.25), (0.80, 0.13, 0.16), (0.60, 0.05, 0.14), veins=9.0),
            Tissue(3.0e5, 300.0), columns=8, vary=0.05,
        ),
        Whorl(
            "inner_petals", 3, petal(0.029, 0.008, (40.0, 84.0, 92.0, 94.0), cup=0.002, rounding=0.3),
            BladePaint((0.90, 0.78, 0.30), (0.86, 0.22, 0.18), (0.64, 0.08, 0.14), veins=7.0),
            Tissue(1.8e5, 280.0), columns=6, turn=0.5, vary=0.05,
        ),
    ),
    (LeafAt(0.30, 60.0, leaf(0.048, 0.009, rise=(72.0, 74.0, 66.0, 50.0), rounding=0.0, cup=0.004)),),
    RoundPaint(GREEN, (0.75, 0.74, 0.30), border=0.75),
    columns=36,
    receptacle=0.0075,
    dome=0.004,
    lean=5.0,
)  # fmt: skip
_POPPY = Species(
    "poppy",
    (
        Whorl(
            "petals", 4, petal(
                0.028, 0.021, (12.0, 32.0, 42.0, 40.0), widths=(0.22, 0.62, 0.95, 1.0, 0.9), cup=0.003,
                ruffle=0.0014, waves=3.0, rounding=0.28,
            ),
            BladePaint((0.16, 0.06, 0.12), (0.90, 0.24, 0.10), (0.62, 0.10, 0.08), veins=13.0),
            Tissue(1.6e5, 240.0), columns=8,
        ),
    ),
    (LeafAt(0.45, 120.0, leaf(0.030, 0.007, ruffle=0.0015)),),
    RoundPaint(GREEN, (0.24, 0.24, 0.16), border=0.5, florets=True),
    columns=48,
    dome=0.006,
    lean=14.0,
    radius=0.0040,
)  # fmt: skip
_LILY = Species(
    "lily",
    (
        Whorl(
            "petals", 6, petal(
                0.042, 0.0085, (46.0, 50.0, 25.0, -20.0, -60.0), widths=(0.35, 0.7, 1.0, 0.85, 0.5, 0.2),
                cup=0.0015, rounding=0.1, rows=14,
            ),
            BladePaint((0.95, 0.80, 0.86), (0.90, 0.45, 0.62), (0.55, 0.10, 0.26), veins=3.0, spots=0.17),
            Tissue(3.2e5, 280.0), columns=4, vary=0.06,
        ),
    ),
    (
        LeafAt(0.34, 0.0, leaf(0.033, 0.0060)), LeafAt(0.48, 140.0, leaf(0.030, 0.0058)),
        LeafAt(0.62, 260.0, leaf(0.027, 0.0055)),
    ),
    RoundPaint(GREEN, (0.80, 0.84, 0.50), border=0.6),
    columns=36,
    receptacle=0.0068,
    dome=0.009,
    lean=18.0,
    stem_substance=Tissue(1.0e6, 420.0),
)  # fmt: skip
_SUNFLOWER = Species(
    "sunflower",
    (
        Whorl(
            "petals", 16, petal(
                0.021, 0.0055, (22.0, 18.0, 8.0), widths=(0.5, 0.9, 1.0, 0.75, 0.3), cup=0.001, rounding=0.1
            ),
            BladePaint((0.86, 0.55, 0.05), (0.96, 0.80, 0.12), (0.74, 0.45, 0.04), veins=5.0),
            Tissue(2.4e5, 270.0), columns=3,
        ),
    ),
    (
        LeafAt(0.42, 80.0, leaf(0.034, 0.013, widths=(0.2, 0.8, 1.0, 0.8, 0.45, 0.1))),
        LeafAt(0.60, 250.0, leaf(0.030, 0.012, widths=(0.2, 0.8, 1.0, 0.8, 0.45, 0.1))),
    ),
    centre((0.36, 0.20, 0.10)),
    sides=16,
    columns=64,
    receptacle=0.0165,
    flare=0.0065,
    dome=0.004,
    radius=0.0055,
    top_radius=0.0048,
    stem_substance=Tissue(9e5, 420.0),
    centre_substance=Tissue(1.1e5, 300.0),
)  # fmt: skip
_ANEMONE = Species(
    "anemone",
    (
        Whorl(
            "petals", 8, petal(0.026, 0.0105, (20.0, 28.0, 24.0, 12.0), cup=0.0025, rounding=0.25),
            BladePaint((0.88, 0.86, 0.95), (0.36, 0.30, 0.78), (0.22, 0.16, 0.56), veins=9.0),
            Tissue(1.9e5, 250.0), columns=4,
        ),
    ),
    (
        LeafAt(0.70, 30.0, leaf(0.024, 0.006)), LeafAt(0.70, 150.0, leaf(0.024, 0.006)),
        LeafAt(0.70, 270.0, leaf(0.024, 0.006)),
    ),
    centre((0.10, 0.09, 0.16)),
    columns=48,
    dome=0.006,
)  # fmt: skip
_COSMOS = Species(
    "cosmos",
    (
        Whorl(
            "petals", 8, petal(
                0.030, 0.0125, (10.0, 16.0, 10.0, 2.0), widths=(0.25, 0.6, 0.9, 1.0, 0.95), cup=0.001,
                rounding=-0.08, ruffle=0.0008, waves=2.0,
            ),
            BladePaint((0.70, 0.16, 0.44), (0.93, 0.58, 0.78), (0.66, 0.22, 0.50), veins=11.0),
            Tissue(2.0e5, 240.0), columns=4,
        ),
    ),
    (LeafAt(0.50, 200.0, leaf(0.036, 0.004, rise=(55.0, 45.0, 25.0))),),
    centre((0.90, 0.72, 0.14)),
    columns=48,
    receptacle=0.0080,
    radius=0.0042,
    lean=12.0,
)  # fmt: skip
_BUTTERCUP = Species(
    "buttercup",
    (
        Whorl(
            "petals", 5, petal(
                0.022, 0.0135, (20.0, 52.0, 60.0, 55.0), widths=(0.3, 0.7, 0.98, 1.0, 0.85), cup=0.003,
                rounding=0.3,
            ),
            BladePaint((0.80, 0.66, 0.06), (0.97, 0.86, 0.12), (0.76, 0.60, 0.06), veins=9.0),
            Tissue(1.7e5, 270.0), columns=6,
        ),
    ),
    (LeafAt(0.50, 310.0, leaf(0.028, 0.009)), LeafAt(0.66, 130.0, leaf(0.022, 0.007))),
    centre((0.72, 0.74, 0.16)),
    sides=10,
    columns=40,
    receptacle=0.0070,
    radius=0.0040,
)  # fmt: skip
_BELLFLOWER = Species(
    "bellflower",
    (
        Whorl(
            "petals", 5, petal(
                0.034, 0.0110, (10.0, 72.0, 80.0, 66.0, 30.0), widths=(0.4, 0.85, 1.0, 1.0, 0.7, 0.25),
                cup=0.0015, rounding=0.1, rows=12,
            ),
            BladePaint((0.62, 0.58, 0.92), (0.40, 0.34, 0.86), (0.26, 0.20, 0.62), veins=7.0),
            Tissue(2.6e5, 280.0), columns=6, vary=0.05,
        ),
    ),
    (LeafAt(0.32, 180.0, leaf(0.030, 0.009)), LeafAt(0.50, 20.0, leaf(0.026, 0.008))),
    RoundPaint(GREEN, (0.90, 0.90, 0.62), border=0.6),
    sides=10,
    columns=40,
    receptacle=0.0072,
    dome=0.008,
    stem=0.098,
    lean=128.0,
    radius=0.0050,
    top_radius=0.0038,
    stem_substance=Tissue(1.3e6, 420.0),
)  # fmt: skip
_LOTUS = Species(
    "lotus",
    (
        Whorl(
            "petals", 8, petal(
                0.030, 0.0105, (8.0, 30.0, 40.0, 46.0), widths=(0.4, 0.8, 1.0, 0.9, 0.6, 0.15), cup=0.002,
                rounding=0.05,
            ),
            BladePaint((0.96, 0.92, 0.88), (0.92, 0.52, 0.66), (0.82, 0.34, 0.54), veins=9.0),
            Tissue(2.4e5, 300.0), columns=4, vary=0.05,
        ),
        Whorl(
            "inner_petals", 8, petal(
                0.025, 0.0080, (45.0, 68.0, 78.0, 82.0), widths=(0.4, 0.8, 1.0, 0.9, 0.6, 0.15), cup=0.001,
                rounding=0.05,
            ),
            BladePaint((0.97, 0.95, 0.86), (0.95, 0.70, 0.78), (0.88, 0.50, 0.62), veins=7.0),
            Tissue(1.5e5, 280.0), columns=4, turn=0.5, vary=0.05,
        ),
    ),
    (LeafAt(0.38, 100.0, leaf(0.034, 0.014, widths=(0.15, 0.85, 1.0, 0.95, 0.7, 0.3), rounding=0.2)),),
    centre((0.84, 0.80, 0.24)),
    sides=16,
    columns=48,
    receptacle=0.0100,
    dome=0.006,
    radius=0.0050,
    top_radius=0.0042,
    lean=4.0,
)  # fmt: skip
_PEONY = Species(
    "peony",
    (
        Whorl(
            "petals", 6, petal(
                0.027, 0.0145, (6.0, 24.0, 38.0, 44.0), widths=(0.3, 0.7, 0.98, 1.0, 0.88), cup=0.003,
                ruffle=0.0012, waves=2.0, rounding=0.22,
            ),
            BladePaint((0.80, 0.24, 0.42), (0.95, 0.66, 0.74), (0.74, 0.30, 0.46), veins=11.0),
            Tissue(1.8e5, 260.0), columns=5, vary=0.06,
        ),
        Whorl(
            "inner_petals", 6, petal(
                0.020, 0.0095, (45.0, 80.0, 92.0, 98.0), widths=(0.4, 0.8, 1.0, 0.95, 0.75), cup=0.001,
                rounding=0.2,
            ),
            BladePaint((0.70, 0.14, 0.32), (0.90, 0.44, 0.58), (0.62, 0.14, 0.32), veins=7.0),
            Tissue(1.1e5, 240.0), columns=5, turn=0.5, vary=0.05,
        ),
    ),
    (LeafAt(0.36, 40.0, leaf(0.036, 0.011)), LeafAt(0.54, 215.0, leaf(0.030, 0.010))),
    centre((0.92, 0.76, 0.22)),
    columns=48,
    receptacle=0.0100,
    dome=0.005,
    radius=0.0050,
    top_radius=0.0042,
    stem_substance=Tissue(8e5, 420.0),
)  # fmt: skip
_CROCUS = Species(
    "crocus",
    (
        Whorl(
            "petals", 6, petal(
                0.036, 0.0095, (25.0, 66.0, 80.0, 76.0, 66.0), widths=(0.4, 0.7, 0.95, 1.0, 0.75, 0.25),
                cup=0.002, rounding=0.08, rows=12,
            ),
            BladePaint((0.88, 0.84, 0.94), (0.56, 0.30, 0.74), (0.38, 0.14, 0.56), veins=9.0),
            Tissue(2.2e5, 270.0), columns=4, vary=0.06,
        ),
    ),
    (
        LeafAt(0.34, 45.0, leaf(0.046, 0.0040, thickness=0.0026, rise=(70.0, 66.0, 52.0, 30.0))),
        LeafAt(0.42, 170.0, leaf(0.042, 0.0040, thickness=0.0026, rise=(70.0, 64.0, 48.0, 24.0))),
        LeafAt(0.38, 290.0, leaf(0.044, 0.0040, thickness=0.0026, rise=(70.0, 66.0, 50.0, 28.0))),
    ),
    RoundPaint(PALE_GREEN, (0.92, 0.56, 0.10), border=0.5, florets=True),
    columns=36,
    receptacle=0.0066,
    dome=0.010,
    stem=0.060,
    radius=0.0042,
    lean=4.0,
    leaf_substance=Tissue(6e5, 320.0),
    stem_paint=RoundPaint(PALE_GREEN, PALE_GREEN),
)  # fmt: skip

SPECIES: Mapping[str, Species] = {
    s.name: s
    for s in (
        _DAISY, _TULIP, _POPPY, _LILY, _SUNFLOWER, _ANEMONE, _COSMOS, _BUTTERCUP, _BELLFLOWER, _LOTUS,
        _PEONY, _CROCUS,
    )
}  # fmt: skip


def species(name: str) -> Species:
    """The species called `name`. Raises ValueError for names that there are not."""
    if name not in SPECIES:
        raise ValueError(f"species '{name}': expected one of {', '.join(SPECIES)}")
    return SPECIES[name]
