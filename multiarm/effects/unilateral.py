"""The effect kernels of unilateral contacts."""

from __future__ import annotations

from multiarm.contacts.unilateral import DRY_JOINT, UnilateralConstraints
from multiarm.dynamics.effect_kernels import APPLIED, EffectKernel


def unilateral_kernels(unilateral: UnilateralConstraints | None, joints: int) -> list[EffectKernel]:
    """The kernels of unilateral contacts, and of dry friction in ``joints`` joints.

    Impacts and sliding friction have no kernel: other functions write their work.
    """
    if unilateral is None:
        return []
    kernels = [EffectKernel("impacts", None, APPLIED)]
    if any(constraint.tangents for constraint in unilateral.constraints):
        kernels.append(EffectKernel("contact_friction", None, APPLIED))
    if any(constraint.kind == DRY_JOINT for constraint in unilateral.constraints):
        from multiarm.effects.joint_friction import coulomb_kernel

        kernels.append(coulomb_kernel(joints))
    if unilateral.compliant is not None:
        from multiarm.effects.contact_compliance import compliance_kernel

        kernels.append(compliance_kernel(unilateral.compliant))
    return kernels
