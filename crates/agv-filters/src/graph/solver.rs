//! The poses that explain a graph best.

use super::{Layout, PoseGraph, SparseNormalEquations, problem::GraphProblem};
use agv_core::{
    Error, check,
    geometry::LieGroup,
    solve::{
        LeastSquaresReport, LeastSquaresWorkspace, LevenbergMarquardt, LevenbergMarquardtParams, NormalSystem,
        StructuredLeastSquares,
    },
};

/// Parameters of a [`PoseGraphSolver`].
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct PoseGraphSolverParams {
    /// When to stop, and how boldly to start.
    pub descent: LevenbergMarquardtParams,
    /// By how much a stage of [`optimize_graduated`](PoseGraphSolver::optimize_graduated) narrows the kernels: the factor of their
    /// squared scales, at least 1.01.
    pub graduation: f64,
}

impl Default for PoseGraphSolverParams {
    /// Nearly full steps of Gauss and Newton while they lower the cost, until a step promises less than a thousand-millionth of it;
    /// stages of 1.4 as Yang et al. take them.
    fn default() -> Self {
        let descent = LevenbergMarquardtParams {
            initial_damping: 1e-6,
            cost_tolerance: 1e-9,
            gradient_tolerance: 1e-9,
            ..LevenbergMarquardtParams::default()
        };
        Self { descent, graduation: 1.4 }
    }
}

/// Moves the poses of graphs to where their relations fit best; keeps its memory, and the order of elimination while a graph's
/// pattern stays. A graph that grows is solved from where its poses are: a closure that changes little takes a step or two.
///
/// See [`PoseGraph`] for an example.
#[derive(Debug)]
pub struct PoseGraphSolver<G: LieGroup> {
    params: PoseGraphSolverParams,
    pub(super) workspace: LeastSquaresWorkspace<SparseNormalEquations, Vec<G>>,
    /// Block of unknowns of each pose of the graph that was solved last.
    pub(super) blocks: Vec<Option<u32>>,
}

/// Full steps of Gauss and Newton that are tried before a descent, whether or not they lower the cost.
///
/// Relations that are stiff in one direction and slack in others make curved valleys: a descent creeps along them in hundreds of
/// steps, full steps climb their side once and are down in a few (the watchdog of Chamberlain et al., 1982).
const FREE_STEPS: usize = 10;

/// Steps within a stage that is not the last: the next one starts from a fair guess, not from the minimum.
const STEPS_PER_STAGE: usize = 3;

impl<G: LieGroup> PoseGraphSolver<G> {
    /// A solver.
    ///
    /// # Errors
    /// Tolerances that cannot be some, and [`Error::OutOfRange`] for a graduation below 1.01.
    pub fn new(params: PoseGraphSolverParams) -> Result<Self, Error> {
        LevenbergMarquardt::new(params.descent)?;
        check::in_range("graduation", params.graduation, 1.01, f64::MAX)?;
        let workspace = LeastSquaresWorkspace::new(SparseNormalEquations::default(), Vec::new());
        Ok(Self { params, workspace, blocks: Vec::new() })
    }

    /// Moves the poses to a minimum near where they are; [`initialize`](Self::initialize) first where they are no good guess. A step
    /// is linear in poses and relations, but for the factor's fill. Ten full steps of Gauss and Newton come before the descent at most,
    /// and count in the report; the cost never ends higher than it began.
    ///
    /// # Errors
    /// [`Error::NotFinite`] for poses so far off that their residuals overflow, [`Error::TooMany`] for a graph that memory has no
    /// room for. The poses are then as they were.
    pub fn optimize(&mut self, graph: &mut PoseGraph<G>) -> Result<LeastSquaresReport, Error> {
        self.solve(graph, false)
    }

    /// As [`optimize`](Self::optimize), for graphs with many false relations: kernels so wide that all relations count come first, and
    /// are narrowed stage by stage to what they are (graduated non-convexity: Yang et al., *Graduated non-convexity for robust spatial
    /// perception*, 2020). Relations whose kernel is [`Square`](agv_core::solve::RobustKernel::Square) are taken to be true in every
    /// stage; give those that may be false a bounded kernel, [`GemanMcClure`](agv_core::solve::RobustKernel::GemanMcClure) or
    /// [`DynamicCovarianceScaling`](agv_core::solve::RobustKernel::DynamicCovarianceScaling).
    ///
    /// Unlike there the cost may end higher than it began: the stages lower other ones. The report counts the steps of all stages. There are about `ln(2 s / c²) / ln(graduation)` of them for a worst squared
    /// residual `s` and a scale `c`.
    ///
    /// # Errors
    /// As [`optimize`](Self::optimize).
    pub fn optimize_graduated(&mut self, graph: &mut PoseGraph<G>) -> Result<LeastSquaresReport, Error> {
        self.solve(graph, true)
    }

    fn solve(&mut self, graph: &mut PoseGraph<G>, graduated: bool) -> Result<LeastSquaresReport, Error> {
        let report = self.descend(graph, graduated);
        if report.is_err() {
            // What was summed up is of no minimum: nothing is known of any pose.
            self.blocks.clear();
        }
        report
    }

    fn descend(&mut self, graph: &mut PoseGraph<G>, graduated: bool) -> Result<LeastSquaresReport, Error> {
        let free = graph.blocks_into(&mut self.blocks);
        let blocks = &self.blocks;
        let pairs = graph
            .relations()
            .iter()
            .filter_map(|relation| blocks[relation.from.index()].zip(blocks[relation.to.index()]));
        self.workspace.system.reset(Layout::uniform(G::DOF, free), pairs)?;
        let mut poses = graph.poses().to_vec();
        let (relations, priors) = (graph.relations(), graph.priors());
        let mut problem = GraphProblem { relations, priors, blocks, widening: 1.0 };
        let mut steps = 0;
        if graduated {
            let descent = LevenbergMarquardtParams {
                max_iterations: STEPS_PER_STAGE.min(self.params.descent.max_iterations),
                ..self.params.descent
            };
            let descent = LevenbergMarquardt::new(descent)?;
            let mut widening = first_widening(&problem, &poses)?;
            while widening > 1.0 {
                problem.widening = widening.sqrt();
                steps += descent.minimize_structured(&mut problem, &mut poses, &mut self.workspace)?.iterations;
                widening /= self.params.graduation;
            }
            problem.widening = 1.0;
        }
        steps += free_steps(&mut problem, &mut poses, &mut self.workspace.system, &self.params.descent);
        let descent = LevenbergMarquardt::new(self.params.descent)?;
        let mut report = descent.minimize_structured(&mut problem, &mut poses, &mut self.workspace)?;
        report.iterations += steps;
        *graph.poses_mut() = poses;
        Ok(report)
    }
}

/// Goes full steps, and to where they led if that is lower than the start; the number of steps.
pub(crate) fn free_steps<P: StructuredLeastSquares<SparseNormalEquations>>(
    problem: &mut P,
    poses: &mut P::State,
    system: &mut SparseNormalEquations,
    params: &LevenbergMarquardtParams,
) -> usize {
    let (mut here, mut next, mut step) = (poses.clone(), poses.clone(), Vec::new());
    let mut steps = 0;
    while steps < FREE_STEPS.min(params.max_iterations) {
        system.clear();
        problem.linearize(&here, system);
        step.clear();
        step.extend(system.gradient().iter().map(|slope| -slope));
        if system.check().is_err() || !system.factorize() || !system.substitute(&mut step) {
            break;
        }
        let promised = -0.5 * step.iter().zip(system.gradient()).map(|(step, slope)| step * slope).sum::<f64>();
        if promised <= params.cost_tolerance * system.cost() {
            break;
        }
        problem.retract_into(&here, &step, &mut next);
        std::mem::swap(&mut here, &mut next);
        steps += 1;
    }
    if steps > 0 && problem.cost(&here) < problem.cost(poses) {
        *poses = here;
    }
    steps
}

/// By what the squared scales of the kernels are to be multiplied first: `2 s / c²` of the worst relation, so that even the
/// worst counts nearly in full, by (2/3)² under Geman–McClure (Yang et al., remark 5).
fn first_widening<G: LieGroup>(problem: &GraphProblem<'_, G>, poses: &[G]) -> Result<f64, Error> {
    let scaled = problem.squares(poses).filter_map(|(kernel, square)| Some(2.0 * square / kernel.scale()?.powi(2)));
    let worst = scaled.fold(0.0, |worst: f64, scaled| if scaled > worst || scaled.is_nan() { scaled } else { worst });
    check::finite("squared residual", worst)
}
