"""What an unsure boundary leaves unknown of materials: a part that is thinner than its mesh, and stiffer.

Motion determines what a part weighs and how hard it is to bend, not what its material is: where its volume
is smaller by a factor k, because its surface lies further in, the same motion takes a density that is higher
by k and a modulus higher by k^3, as the rigidity of a plate goes with the third power of its thickness
(Timoshenko and Woinowsky-Krieger, "Theory of Plates and Shells", 1959, eq. 3); of a rod it is k^2, the larger
is taken. By a shift s of the surface along its normal k is 1 + s A / V, A the area and V the smaller volume.
In logarithms this is a nuisance parameter of each part, normal about zero: the measurements' information is
marginalised over it, and what it does to an estimate that takes the mesh for right adds to its covariance.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from mphygs.capture.meshes import Part
from mphygs.model.belief import Parameter

# Standard deviation of a boundary that pictures show, over the width of a pixel at the object, where a part
# is many pixels thick and where it is thinner than UNRESOLVED of them: what is thinner looks that thick.
# Chosen by how much too large parts of synthetic flowers come out: `volume_ratio` of `benchmarks/flowers`.
RESOLVED, THIN, UNRESOLVED = 0.15, 0.5, 2.5
POWERS = {"youngs_modulus": 3.0, "density": 1.0}


def found_boundary(thickness: float, pixel: float) -> float:
    """Standard deviation of the boundary [m] of a part found in pictures. thickness: as it was found [m];
    pixel: width at the object [m]."""
    wide = UNRESOLVED * pixel / thickness if thickness > 0 else np.inf
    return pixel * max(RESOLVED, THIN * min(1.0, wide**3))


def boundary_columns(parts: Sequence[Part], free: Sequence[Parameter]) -> np.ndarray:
    """(P, K) change of the free coordinates when the boundary of one of K parts, those whose boundary is not
    known exactly, lies one standard deviation further in."""
    number = {p.key: k for k, p in enumerate(free)}
    columns = []
    for part in parts:
        column = np.zeros(len(free))
        thinner = math.log1p(part.boundary * part.area / part.volume)
        for quantity, power in POWERS.items():
            key = f"{part.name}.{quantity}"
            if key in number:
                column[number[key]] = power * thinner
        if np.any(column):
            columns.append(column)
    return np.stack(columns, axis=1) if columns else np.zeros((len(free), 0))


def marginalised(information: np.ndarray, columns: np.ndarray) -> np.ndarray:
    """Fisher information (P, P) of the measurements without what they say only if nuisances are known.

    columns: (P, K), change of the coordinates with K independent nuisances, one standard deviation each.
    """
    told = information @ columns
    own = np.eye(columns.shape[1]) + columns.T @ told
    return information - told @ np.linalg.solve(own, told.T)


def widened(
    covariance: np.ndarray, information: np.ndarray, columns: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Covariance of an estimate that knows nothing of K nuisances, and information without them, (P, P).

    covariance: of that estimate if there were none, the inverse of information and the priors' together;
    columns: as for `marginalised`. Measurements see coordinates and nuisances in one, priors do not.
    """
    moved = covariance @ information @ columns
    return covariance + moved @ moved.T, marginalised(information, columns)
