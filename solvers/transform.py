"""Reformulation of programs for back ends, with the inverse mapping of multipliers."""

from __future__ import annotations

from dataclasses import dataclass, replace

import casadi as ca
import numpy as np

from solvers.program import Array, Block, Instance, Placement, Program
from solvers.template import Degree, Template

__all__ = ["Smooth", "smooth"]


@dataclass(frozen=True, eq=False)
class Smooth:
    """A program whose cones are stated as smooth rows, and the mapping back to the original.

    A cone ``||u|| <= t`` becomes ``t^2 - u'u >= 0`` and, where ``t`` is not constant, ``t >= 0``.
    """

    original: Program
    program: Program

    def instance(self, instance: Instance) -> Instance:
        """The same instance data for the smooth program."""
        added = self.program.n_rows - self.original.n_rows
        return replace(
            instance,
            row_lower=np.concatenate([instance.row_lower, np.zeros(added)]),
            row_upper=np.concatenate([instance.row_upper, np.full(added, np.inf)]),
        )

    def row_multipliers(self, lam_g: Array, z: Array, s: Array) -> Array:
        """Multipliers of the smooth rows, from those of the cones at cone values ``s``.

        Where ``t > 0``, ``-z_t / (2 t)`` is the multiplier of ``t^2 - u'u >= 0``.
        """
        parts = [lam_g]
        for cone in self.original.cones.values():
            t, z_t = s[cone.index[0]], z[cone.index[0]]
            parts.append(-z_t / np.maximum(2.0 * t, 1e-8))
            if _sign_name(cone.name) in self.program.rows:
                parts.append(np.zeros(t.size))
        return np.concatenate(parts)

    def cone_multipliers(self, lam_g: Array, s: Array) -> Array:
        """Cone multipliers ``z`` (in the dual cone), from multipliers of the smooth rows."""
        z = np.zeros(self.original.n_cone_values)
        for cone in self.original.cones.values():
            weight = self.program.rows[cone.name].read(lam_g).ravel(order="F")
            z[cone.index[0]] = -2.0 * weight * s[cone.index[0]]
            z[cone.index[1:]] = 2.0 * weight * s[cone.index[1:]]
            sign = self.program.rows.get(_sign_name(cone.name))
            if sign is not None:
                z[cone.index[0]] -= sign.read(lam_g).ravel(order="F")
        return z


def smooth(program: Program) -> Smooth:
    """State every cone of ``program`` as smooth rows; a program without cones is unchanged."""
    if not program.cones:
        return Smooth(program, program)
    rows = dict(program.rows)
    constraints = list(program.constraints)
    offset = program.n_rows
    for cone, placement in zip(program.cones.values(), program.cone_values, strict=True):
        template = placement.template
        t, u = template.outputs[0], template.outputs[1:]
        squares = [("", t**2 - ca.sumsqr(u))]
        if template.degrees[0] > Degree.CONSTANT:
            squares.append(("sign", t))
        for suffix, output in squares:
            name = _sign_name(cone.name) if suffix else cone.name
            shape = (cone.items, cone.stages)
            block = Block(name, *shape, offset, np.zeros(shape), np.full(shape, np.inf), np.zeros(shape))
            offset += block.size
            rows[name] = block
            constraints.append(
                Placement(
                    Template(name, template.variables, template.parameters, output),
                    placement.variables,
                    placement.parameters,
                    block.index.reshape(1, -1, order="F"),
                    name,
                )
            )
    lowered = replace(program, rows=rows, constraints=tuple(constraints), cones={}, cone_values=())
    return Smooth(program, lowered)


def _sign_name(name: str) -> str:
    return f"{name} (t >= 0)"
