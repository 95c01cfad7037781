"""A real silicone beam by motion capture: elastic, then with viscosity. Needs the capture's folder."""

import sys
from pathlib import Path

import mphygs

DATA = Path(__file__).resolve().parents[2] / "shared" / "data" / "silicone-beam"


def main(folder: Path = DATA) -> mphygs.Steps:
    """Fit one motion; the other one stays unseen."""
    told = lambda share, text: print(f"{share:.0%}", text)  # noqa: E731
    elastic = mphygs.fit(folder, sequences="gravity-a", progress=told)
    viscous = mphygs.extend(elastic, "viscosity")
    for row in viscous.rows():
        print(row)
    return viscous


if __name__ == "__main__":
    main(*(Path(word) for word in sys.argv[1:2]))
