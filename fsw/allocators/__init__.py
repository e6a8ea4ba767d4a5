"""Allocators: from a body torque to four wheel torques within limits."""

from __future__ import annotations

from fsw.allocators.direct import Direct
from fsw.allocators.pseudo_inverse import PseudoInverse
from fsw.allocators.settings import DirectAllocationConfig, PseudoInverseConfig, TransposeConfig
from fsw.allocators.transpose import Transpose
from fsw.families import Allocator
from fsw.registry import Registry

REGISTRY: Registry[Allocator] = Registry(
    (DirectAllocationConfig, Direct),
    (PseudoInverseConfig, PseudoInverse),
    (TransposeConfig, Transpose),
)
