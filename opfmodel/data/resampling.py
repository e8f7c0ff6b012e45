"""Series at steps of another length."""

from __future__ import annotations

from typing import Literal, get_args

import numpy as np
import numpy.typing as npt

from opfmodel.errors import ProfileError, shown

__all__ = ["Resample", "check_method", "resampled"]

Array = npt.NDArray[np.float64]
Index = npt.NDArray[np.int64]
Resample = Literal["mean", "interpolate"]


def check_method(method: str | None) -> None:
    """Raise :class:`ProfileError` unless a method of resampling is known."""
    if method is not None and method not in get_args(Resample):
        raise ProfileError(f"resample = {shown(method)}: must be 'mean' or 'interpolate'")


def resampled(values: Array, edges: Index, wanted: Index, method: Resample) -> Array:
    r"""Return a series at other steps.

    ``mean`` takes a value as constant over its step and returns the average over each new step,

    .. math::
        y_k = \frac{1}{S} \sum_i |T_k \cap t_i|\, x_i,

    which keeps the energy: means of shorter steps, or repeated values of longer ones. ``interpolate``
    takes a value as that of the beginning of its step, and returns the values at the beginnings of the
    new steps on straight lines between them; after the last one, it stays constant.

    Parameters
    ----------
    values
        One value per step.
    edges
        Beginnings of the steps and end of the last, integers.
    wanted
        The same of the new steps, which lie within the others.

    Raises
    ------
    ProfileError
        Infinite values cannot be interpolated.
    """
    if method == "interpolate":
        if not np.isfinite(values).all():
            raise ProfileError("resample: interpolate: infinite values cannot be interpolated; use mean")
        return np.asarray(np.interp(wanted[:-1] - edges[0], edges[:-1] - edges[0], values), dtype=float)
    cuts = np.union1d(edges, wanted)
    cuts = cuts[(cuts >= wanted[0]) & (cuts <= wanted[-1])]
    begins, lengths = cuts[:-1], np.diff(cuts)
    source = np.searchsorted(edges, begins, side="right") - 1
    target = np.searchsorted(wanted, begins, side="right") - 1
    size = wanted.size - 1
    share = lengths / np.diff(wanted)[target]
    return np.asarray(np.bincount(target, share * values[source], minlength=size), dtype=float)
