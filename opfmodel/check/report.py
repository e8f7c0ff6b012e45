"""The outcome of a check."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

__all__ = ["Report", "Violation"]


@dataclass(frozen=True)
class Violation:
    """The largest violation of one family of constraints.

    Attributes
    ----------
    value
        Violation in per unit on the network's ``base_mva`` (energies in p.u. h), or in radians.
    component, time
        Component where it occurs, and beginning of the stage, h; counted from the first stage of the data
        if these have time stamps.
    moment
        Beginning of the stage as text: ``hour 3``, or a local time.
    physical, unit
        Violation in MW, MVAr, MVA, MWh, degrees or, for voltages, p.u.
    relative
        Violation in per unit on ``Network.scale_mva``, which does not depend on the base, or in radians.
    """

    family: str
    value: float
    component: str
    time: float
    moment: str
    physical: float
    unit: str
    relative: float

    def __str__(self) -> str:
        amount = f"{self.value:.1e} p.u."
        if self.unit == "deg":
            amount = f"{self.value:.1e} rad"
        return amount if self.unit == "p.u." else f"{amount} ({self.physical:.1e} {self.unit})"


@dataclass
class Report:
    """Outcome of :func:`check`.

    Attributes
    ----------
    violations
        Largest violation of each family of constraints, including zero violations.
    unserved
        Largest unserved active and reactive power of a load, if the data contain any. Load shedding
        violates no limit and is measured as energy. Unserved power outside zero to the demand is a
        violation, and so is power without a source (``p_shortage`` and the like), without which the
        balance does not hold.
    cost
        Recomputed operating cost over all stages, in the currency of the network.
    unchecked
        Items that could not be verified because a formulation or device is from another package.
    simultaneous
        Maximum power, p.u., at which a storage with losses charges and discharges simultaneously, or a DC
        line with losses carries power both ways. This is not a violation but shows that the model is not
        tight.
    currency
        Name of the currency of the network.
    """

    violations: dict[str, Violation] = field(default_factory=dict)
    unserved: dict[str, Violation] = field(default_factory=dict)
    cost: float = 0.0
    simultaneous: float = 0.0
    unchecked: tuple[str, ...] = ()
    currency: str = "$"

    @property
    def max_violation(self) -> float:
        """Largest violation of all families, without unserved power."""
        return max((v.value for v in self.violations.values()), default=0.0)

    @property
    def worst(self) -> Violation | None:
        """Violation that is largest in the relative measure."""
        return max(self.violations.values(), key=lambda v: v.relative, default=None)

    def as_dict(self) -> dict[str, dict[str, Any]]:
        """Nonzero violations by family, as plain data in physical units."""
        return {
            v.family: {
                "value": v.physical,
                "unit": v.unit,
                "component": v.component,
                "time": v.time,
                "moment": v.moment,
            }
            for v in self.violations.values()
            if v.value > 0
        }

    def __str__(self) -> str:
        lines = [
            f"{v.family:<22} {v}  at {v.component}, {v.moment}"
            for family in (self.violations, self.unserved)
            for v in sorted(family.values(), key=lambda v: -v.value)
        ]
        left_out = [f"{'not checked':<22} {what}" for what in self.unchecked]
        return "\n".join([*lines, f"{'cost':<22} {self.cost:.6f} {self.currency}", *left_out])
