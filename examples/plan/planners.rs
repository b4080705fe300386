//! Who can be asked.

use super::Result;
use agv_nav::{
    core::{
        grid::{Grid, GridLayout},
        roles::GlobalPlanner,
    },
    plan::grid::{
        AStar, AStarParams, Anya, Bidirectional, DStarLite, Dijkstra, GridPlanner, GridPlannerParams, GridSolver, Jps,
        JpsPlus, LazyThetaStar, ThetaStar,
    },
};
use clap::ValueEnum;

#[derive(Clone, Copy, PartialEq, Eq, ValueEnum)]
#[value(rename_all = "snake_case")]
pub(crate) enum Algorithm {
    /// By distance from the start alone
    Dijkstra,
    /// A* with the octile distance
    Astar,
    /// A* from both ends
    Bidirectional,
    /// Jump points
    Jps,
    /// Jump points from a table of the map
    #[value(name = "jpsplus", alias = "jps_plus")]
    JpsPlus,
    /// D* Lite: from the goal, and it remembers
    DstarLite,
    /// Theta*: at any angle, nearly shortest
    Theta,
    /// Lazy Theta*: as Theta*, with fewer lines of sight
    LazyTheta,
    /// Anya: at any angle, shortest
    AnyAngle,
}

/// A planner that shows what it looked at.
pub(crate) trait Planner: GlobalPlanner {
    /// The cells that the last search reached.
    fn reached(&self, layout: &GridLayout) -> Grid<bool>;
}

impl<S: GridSolver> Planner for GridPlanner<S> {
    fn reached(&self, layout: &GridLayout) -> Grid<bool> {
        let mut cells = Grid::filled(*layout, false);
        for (node, cell) in cells.values_mut().iter_mut().enumerate() {
            *cell = self.solver().cost(node as u32).is_some();
        }
        cells
    }
}

impl Planner for Anya {
    /// A search of cones has no cells.
    fn reached(&self, layout: &GridLayout) -> Grid<bool> {
        Grid::filled(*layout, false)
    }
}

impl Algorithm {
    pub(crate) fn planner(self) -> Result<Box<dyn Planner>> {
        let (params, a_star) = (GridPlannerParams::default(), AStarParams::default());
        Ok(match self {
            Self::Dijkstra => Box::new(Dijkstra::new(params)?),
            Self::Astar => Box::new(AStar::new(a_star)?),
            Self::Bidirectional => Box::new(Bidirectional::new(a_star)?),
            Self::Jps => Box::new(Jps::new(params)?),
            Self::JpsPlus => Box::new(JpsPlus::new(params)?),
            Self::DstarLite => Box::new(DStarLite::new(params)?),
            Self::Theta => Box::new(ThetaStar::new(params)?),
            Self::LazyTheta => Box::new(LazyThetaStar::new(params)?),
            Self::AnyAngle => Box::new(Anya::new(params)?),
        })
    }

    /// Whether it answers the same question faster when it is asked again.
    pub(crate) fn remembers(self) -> bool {
        self == Self::DstarLite
    }

    /// Whether its paths leave the directions of the grid.
    pub(crate) fn is_any_angle(self) -> bool {
        matches!(self, Self::Theta | Self::LazyTheta | Self::AnyAngle)
    }

    /// As it is given on the command line.
    pub(crate) fn name(self) -> String {
        self.to_possible_value().map_or_else(String::new, |value| value.get_name().to_owned())
    }
}
