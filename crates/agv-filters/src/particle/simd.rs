//! Instruction sets, for tests that results do not depend on them.

use pulp::Arch;

/// The instruction sets that this machine has.
pub(super) fn archs() -> Vec<Arch> {
    let mut archs = vec![Arch::new(), Arch::Scalar];
    #[cfg(target_arch = "x86_64")]
    archs.extend(pulp::x86::V3::try_new().map(Arch::V3));
    archs
}
