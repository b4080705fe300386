//! Which neighbours a cell has.

/// Which neighbours a cell has.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub enum Connectivity {
    /// The four that share an edge.
    Four,
    /// The eight that share an edge or a corner.
    #[default]
    Eight,
}

/// Whether a path may pass the corner of a blocked cell.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub enum CornerRule {
    /// A diagonal step needs both cells beside it free: what a vehicle of some width can drive. The rule of the `MovingAI`
    /// benchmarks.
    #[default]
    Never,
    /// A diagonal step needs one of the cells beside it free.
    OneFree,
    /// A diagonal step may squeeze between two blocked cells.
    Free,
}

impl Connectivity {
    /// Whether two cells that share only a corner can be neighbours *without* a way around it over edges.
    ///
    /// Wherever a diagonal step needs a free cell beside it, that cell leads around the corner in two straight steps: what
    /// can be reached is then the same as without diagonal steps.
    pub(super) fn joins_corners(self, rule: CornerRule) -> bool {
        self == Self::Eight && rule == CornerRule::Free
    }
}
