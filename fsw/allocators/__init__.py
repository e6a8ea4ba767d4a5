"""Allocators: from a body torque to four wheel torques within limits."""

from __future__ import annotations

from fsw.allocators.pseudo_inverse import PseudoInverse, PseudoInverseConfig
from fsw.allocators.transpose import Transpose, TransposeConfig
from fsw.families import Allocator, Registry

REGISTRY: Registry[Allocator] = Registry(
    (PseudoInverseConfig, PseudoInverse),
    (TransposeConfig, Transpose),
)
