"""Effects that change the material at every point, not the equations of motion: one file each in
`material_effects`, found there by the registry."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Protocol

import numpy as np

from mphygs.model.descriptor import ParameterSpec

if TYPE_CHECKING:
    from mphygs.model.belief import Belief


@dataclass(frozen=True, eq=False)
class PointFields:
    """Material at every quadrature point, (B, 8): E [Pa], nu [-], density [kg/m^3]."""

    youngs_modulus: np.ndarray
    poissons_ratio: np.ndarray
    density: np.ndarray


@dataclass(frozen=True, eq=False)
class MaterialChange:
    """Derivative of a material by one number, (B, 8) each: of ln E, nu and ln density; None for zero."""

    youngs_modulus: np.ndarray | None = None
    poissons_ratio: np.ndarray | None = None
    density: np.ndarray | None = None


class Points(Protocol):
    """What a material effect may know of the object. points: (B, 8, 3) [m]; point_part: (B, 8) index of each
    one's part; centroid: (parts, 3) [m]; part_names: of the parts."""

    @property
    def points(self) -> np.ndarray: ...
    @property
    def point_part(self) -> np.ndarray: ...
    @property
    def centroid(self) -> np.ndarray: ...
    @property
    def part_names(self) -> tuple[str, ...]: ...


class MaterialEffect:
    """name, summary, parameters: as of every effect. order: those of a lower one act first; settings: what
    its term needs besides numbers; replaces: its null is no absence, for it takes the place of what the parts
    say."""

    name: str
    summary: str
    parameters: tuple[ParameterSpec, ...]
    order: int = 0
    settings: tuple[str, ...] = ()
    replaces: bool = False

    def start(self, belief: Belief) -> dict[str, float]:
        """Values that it starts from in a belief, where these are not the nulls."""
        return {}

    def changed(
        self,
        material: PointFields,
        values: Mapping[str, float],
        settings: Mapping[str, object],
        object_: Points,
    ) -> PointFields:
        """The material with the effect."""
        raise NotImplementedError

    def derivative(
        self, quantity: str, values: Mapping[str, float], settings: Mapping[str, object], object_: Points
    ) -> MaterialChange:
        """Derivative of the changed material by one of the effect's numbers."""
        raise NotImplementedError


def arm_in_part(settings: Mapping[str, object], object_: Points) -> np.ndarray:
    """(X - centroid).axis in the part that a term names, zero elsewhere, (B, 8) [m]."""
    part = object_.part_names.index(str(settings["part"]))
    axis = np.asarray(settings["axis"], float)
    arm = (object_.points - object_.centroid[part]) @ (axis / np.linalg.norm(axis))
    return np.where(object_.point_part == part, arm, 0.0)


class PartGradient(MaterialEffect):
    """One quantity of one part, exponential along an axis, so that it is nowhere negative. quantity: of
    `PointFields`."""

    quantity: str
    parameters = (ParameterSpec("slope", "1/m", 0.0, -1000.0, 1000.0, 10.0),)
    settings = ("part", "axis")

    def changed(
        self,
        material: PointFields,
        values: Mapping[str, float],
        settings: Mapping[str, object],
        object_: Points,
    ) -> PointFields:
        """The material with the gradient in the part that the term names."""
        factor = np.exp(values["slope"] * arm_in_part(settings, object_))
        return replace(material, **{self.quantity: getattr(material, self.quantity) * factor})

    def derivative(
        self, quantity: str, values: Mapping[str, float], settings: Mapping[str, object], object_: Points
    ) -> MaterialChange:
        """The arm of every point [m]."""
        return MaterialChange(**{self.quantity: arm_in_part(settings, object_)})
