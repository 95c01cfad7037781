"""From markers to a verdict: fit, look, ask what is missing, until nothing is."""

import bar

import mphygs


def main() -> mphygs.Steps:
    """The whole loop over two candidates."""
    capture = bar.make()  # or mphygs.load_capture("your folder")
    found = mphygs.discover(capture, effects=["viscosity", "air_drag"], spacing=0.006)
    print(found.title())
    for key, number in found.parameters.items():
        print(f"{key}: {number.value:.4g} +- {number.std:.2g} {number.unit}")
    return found


if __name__ == "__main__":
    main()
