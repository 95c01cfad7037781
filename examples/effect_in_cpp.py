"""An effect of one's own, in C++: buoyancy.hpp beside this file, as fast as those that are built in.

    pip install . -C cmake.define.MPHYGS_EXTRA_EFFECTS=$PWD/examples

installs the package with it; from then on it is an effect like the others.
"""

import bar

import mphygs
from mphygs.model.registry import effects


def main() -> mphygs.Motion | None:
    """The bar half under water, where this build has the effect."""
    if "buoyancy" not in effects():
        print(__doc__)
        return None
    model = mphygs.Model.of(bar.make(), spacing=0.006).with_effect("buoyancy", {"lift": 9.0, "level": 0.006})
    motion = mphygs.simulate(model)
    print(motion.title())
    return motion


if __name__ == "__main__":
    main()
