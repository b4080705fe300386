//! A [`GridSpace`] as a graph to search: which steps are looked at, and what they cost.

use super::{
    masks::Pruning,
    search::{Frontier, Reached, SearchSpace},
    space::{GridParams, GridSpace},
    step::{DIAGONAL, STRAIGHT, Step},
};

/// What the steps of a grid cost.
pub trait StepPrices {
    /// What is looked up once for all steps from a node.
    type From: Copy;

    /// Cost of the dearest step.
    fn max_step(&self) -> u32;

    /// Looks at the node that is left.
    fn leaving(&self, node: u32) -> Self::From;

    /// Cost of a straight or diagonal step to `next`.
    fn price(&self, from: Self::From, next: u32, is_diagonal: bool) -> u32;
}

/// Steps cost their length.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Lengths;

impl StepPrices for Lengths {
    type From = ();

    fn max_step(&self) -> u32 {
        DIAGONAL
    }

    #[inline]
    fn leaving(&self, _: u32) -> Self::From {}

    #[inline]
    fn price(&self, (): (), _: u32, is_diagonal: bool) -> u32 {
        if is_diagonal { DIAGONAL } else { STRAIGHT }
    }
}

/// Steps cost more where the costmap does, as [`GridParams::cost_weight`] says: the mean of the two cells, the same in both
/// directions.
#[derive(Debug, Clone, Copy)]
pub struct CostWeighted<'a> {
    params: &'a GridParams,
    costs: &'a [u8],
    /// Cost of a straight and a diagonal step between two cells of this cost.
    steps: &'a [[u32; 2]; 256],
}

impl<'a> CostWeighted<'a> {
    /// The prices of a space.
    pub(super) fn of(space: &'a GridSpace) -> Self {
        Self { params: space.params(), costs: space.costs(), steps: space.step_costs() }
    }
}

impl StepPrices for CostWeighted<'_> {
    type From = [u32; 2];

    fn max_step(&self) -> u32 {
        (f64::from(DIAGONAL) * (1.0 + self.params.cost_weight)).ceil() as u32
    }

    #[inline]
    fn leaving(&self, node: u32) -> [u32; 2] {
        self.costs.get(node as usize).map_or([u32::MAX; 2], |&cost| self.steps[cost as usize])
    }

    #[inline]
    fn price(&self, from: [u32; 2], next: u32, is_diagonal: bool) -> u32 {
        let kind = usize::from(is_diagonal);
        u32::midpoint(from[kind], self.leaving(next)[kind])
    }
}

/// A [`GridSpace`] with the steps that are worth a look and their prices.
#[derive(Debug, Clone, Copy)]
pub struct GridView<'a, P> {
    space: &'a GridSpace,
    strides: [u32; 8],
    pruning: &'a Pruning,
    prices: P,
}

/// A [`GridSpace`] whose steps cost their length.
pub type Uniform<'a> = GridView<'a, Lengths>;

/// A [`GridSpace`] whose steps cost more where the costmap does.
pub type Weighted<'a> = GridView<'a, CostWeighted<'a>>;

impl GridSpace {
    /// The graph with steps that cost their length. Of equally short ways one is looked at.
    pub fn uniform(&self) -> Uniform<'_> {
        GridView { space: self, strides: self.strides(), pruning: self.canonical(), prices: Lengths }
    }

    /// As [`uniform`](Self::uniform), but all equally short ways are looked at: what a search from both ends needs, whose
    /// halves could otherwise prefer different ones and never meet.
    pub fn uniform_unpruned(&self) -> Uniform<'_> {
        GridView { pruning: self.reverse_only(), ..self.uniform() }
    }

    /// The graph with steps that cost more near obstacles, as [`GridParams::cost_weight`] says.
    pub fn weighted(&self) -> Weighted<'_> {
        let prices = CostWeighted::of(self);
        GridView { space: self, strides: self.strides(), pruning: self.reverse_only(), prices }
    }
}

impl<P: StepPrices> SearchSpace for GridView<'_, P> {
    type Link = Step;

    fn node_count(&self) -> usize {
        self.space.len()
    }

    fn max_step(&self) -> u32 {
        self.prices.max_step()
    }

    #[inline]
    fn expand(&self, at: Reached<Step>, frontier: &mut impl Frontier<Step>) {
        let mut open = self.pruning.successors(at.link, self.space.mask(at.node));
        let from = self.prices.leaving(at.node);
        while open != 0 {
            let bit = open.trailing_zeros();
            open &= open - 1;
            let next = at.node.wrapping_add(self.strides[bit as usize & 7]);
            let price = self.prices.price(from, next, bit >= 4);
            frontier.reach(next, at.cost.saturating_add(price), Step::from_bit(bit));
        }
    }

    #[inline]
    fn predecessor(&self, node: u32, link: Step) -> Option<u32> {
        self.strides.get(link.index()).map(|stride| node.wrapping_sub(*stride))
    }
}
