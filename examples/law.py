"""Which law of elasticity: each one fitted, and held against frames that were not."""

import bar

import mphygs
from mphygs.model.registry import laws


def main() -> dict[str, float]:
    """rms over sigma on unseen frames, by law."""
    capture = bar.make()
    errors = {}
    for law in laws():
        found = mphygs.fit(capture, effects="viscosity", law=law, spacing=0.006)
        errors[law] = found.sequences["swing"]["predict"].rms_over_sigma
        print(f"{law}: {errors[law]:.3f} sigma, E {found.parameters['bar.youngs_modulus'].value:.4g} Pa")
    return errors


if __name__ == "__main__":
    main()
