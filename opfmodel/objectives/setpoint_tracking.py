"""Tracking of given trajectories."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt

from opfmodel.errors import ModelError, nearest, raise_all, shown
from opfmodel.model import Stage
from opfmodel.network.arrays import PerUnitNetwork
from opfmodel.network.bounds import LARGEST, is_number, number_within
from opfmodel.objectives.base import Objective
from solvers import total

__all__ = ["SetpointTracking", "Setpoints"]

Array = npt.NDArray[np.float64]
Values = Mapping[str, npt.ArrayLike]

# Kind of component of each quantity that can be tracked; all are powers or energies.
_KINDS = {"pg": "generator", "qg": "generator", "e": "storage", "ps": "storage", "qs": "storage"}


class Setpoints:
    """Values to track, in MW, MVAr and MWh.

    Parameters
    ----------
    values
        By ``"component.quantity"`` (``pg``, ``qg``, ``e``, ``ps``, ``qs``), one number for all
        steps or one per step; or a function that returns such a mapping when it is needed.

    Examples
    --------
    >>> sorted(Setpoints({"coal.pg": 80, "cell.e": [50, 60]}).values)
    ['cell.e', 'coal.pg']
    """

    def __init__(self, values: Values | Callable[[], Values]) -> None:
        self._values = values

    @classmethod
    def __get_pydantic_json_schema__(cls, schema: object, handler: object) -> dict[str, Any]:
        """What a scenario file accepts for set-points."""
        numbers = {"anyOf": [{"type": "number"}, {"type": "array", "items": {"type": "number"}}]}
        from_file = {"properties": {"file": {"type": "string"}}, "required": ["file"]}
        return {
            "anyOf": [
                {"const": "single-stage"},
                {"type": "object", **from_file, "additionalProperties": False},
                {"type": "object", "additionalProperties": numbers},
            ]
        }

    @property
    def values(self) -> Values:
        """The values by ``"component.quantity"``."""
        return self._found

    @cached_property
    def _found(self) -> Values:
        found = self._values() if callable(self._values) else self._values
        if not isinstance(found, Mapping):
            raise ModelError(
                f"set-points {found!r}: must be a mapping {{'component.quantity': value or values}}"
            )
        return found

    def arrays(self, network: PerUnitNetwork) -> dict[str, Array]:
        """Return per-unit values by quantity, ``(items, steps)``; NaN where there is no set-point.

        Raises
        ------
        ModelError
            A set-point names an unknown component or quantity, is not a number, or differs in length
            from the others.
        """
        given: dict[str, dict[str, Array]] = {}
        raise_all(self._errors(network))
        length, longest = 1, ""
        for key, value in self.values.items():
            name, _, quantity = str(key).rpartition(".")
            array = _numbers(key, value)
            if array.size > 1 and length > 1 and array.size != length:
                raise ModelError(
                    f"set-point {key!r} has {array.size} values, but {longest!r} has {length}; "
                    "all must have one per step"
                )
            if array.size > 1:
                length, longest = array.size, str(key)
            given.setdefault(quantity, {})[name] = array
        out = {}
        for quantity, members in given.items():
            table = network.tables[_KINDS[quantity]]
            out[quantity] = np.full((len(table), length), np.nan)
            for name, array in members.items():
                out[quantity][table.position[name]] = array / network.base_mva
        return out

    def _errors(self, network: PerUnitNetwork) -> Iterator[ModelError]:
        """Yield the error of each set-point by itself, with its key."""
        for key, value in self.values.items():
            name, _, quantity = str(key).rpartition(".")
            position = network.tables[_KINDS[quantity]].position if quantity in _KINDS else {}
            try:
                _numbers(key, value)
            except ModelError as error:
                yield error
            if quantity not in _KINDS:
                yield ModelError(
                    f"set-point {key!r}: no such quantity; {nearest(quantity, _KINDS)}", str(key)
                )
            elif name not in position:
                near = nearest(name, position)
                yield ModelError(
                    f"set-point {key!r}: no such {_KINDS[quantity]} in service; {near}", str(key)
                )


class SetpointTracking(Objective):
    r"""Squared distance from given trajectories of states and inputs.

    .. math::
        \ell_t = q \left( \|p^g - p^g_s\|^2 + \|q^g - q^g_s\|^2 + \|e - e_s\|^2 \right)
               + r \left( \|p^s - p^s_s\|^2 + \|q^s - q^s_s\|^2 \right)

    in per unit on the network's ``base_mva``. Only quantities with set-points are tracked, reactive
    power only by formulations that have it. Source: Faulwasser and Engelmann (2019), section 5, with
    :math:`Q = I, R = 0.1` and the sequence of single-stage optima.

    Parameters
    ----------
    setpoints
        The trajectories: :class:`Setpoints`, or a mapping for one. In a scenario file
        ``single-stage`` (the optimum of each step on its own), ``{file: values.csv}`` with columns
        headed ``component.quantity``, or ``{component.quantity: value or list}``.
    state_weight, input_weight
        :math:`q` on ``pg``, ``qg``, ``e`` and :math:`r` on ``ps``, ``qs``, in $/(h p.u.²).
    """

    def __init__(
        self,
        setpoints: Setpoints,
        state_weight: float = 1.0,
        input_weight: float = 0.1,
    ) -> None:
        self.setpoints = setpoints if isinstance(setpoints, Setpoints) else Setpoints(setpoints)
        self.state_weight = number_within("set-point tracking: state_weight", state_weight, at_least=0)
        self.input_weight = number_within("set-point tracking: input_weight", input_weight, at_least=0)

    def series(self, network: PerUnitNetwork) -> Mapping[tuple[str, str], Array]:
        """Return the set-points as fields ``pg_setpoint``, ... of their components."""
        arrays = self.setpoints.arrays(network)
        if not arrays:
            raise ModelError("set-point tracking has no set-points; give at least one, such as 'coal.pg'")
        return {(_KINDS[q], f"{q}_setpoint"): np.nan_to_num(array) for q, array in arrays.items()}

    def stage_cost(self, stage: Stage) -> Any:
        """Return the weighted squares of the distances."""
        cost, unit = None, stage.network.rebased**2
        for quantity, array in self.setpoints.arrays(stage.network).items():
            if not stage.has(quantity):
                continue
            followed = np.flatnonzero(~np.isnan(array[:, 0]))
            of = getattr(stage, _KINDS[quantity])
            distance = getattr(of, quantity)[followed] - getattr(of, f"{quantity}_setpoint")[followed]
            weight = self.state_weight if quantity in ("pg", "qg", "e") else self.input_weight
            term = weight * unit * total(distance**2)
            cost = term if cost is None else cost + term
        return cost


def _numbers(key: str, value: npt.ArrayLike) -> Array:
    try:
        array = np.atleast_1d(np.asarray(value, dtype=float))
        if not all(map(is_number, np.asarray(value, dtype=object).flat)):  # no text and no Booleans
            raise TypeError
    except (TypeError, ValueError, OverflowError):
        raise ModelError(
            f"set-point {key!r}: {shown(value)}: must be a number, or one number per step", str(key)
        ) from None
    if array.ndim != 1 or not array.size:
        raise ModelError(f"set-point {key!r}: must be one number per step, not shape {array.shape}", str(key))
    sound = np.abs(array) <= LARGEST
    if not sound.all():
        step = int(np.argmin(sound))
        raise ModelError(
            f"set-point {key!r}: step {step}: {array[step]:g}: must be a finite number "
            f"of at most {LARGEST:g}",
            str(key),
        )
    return array
