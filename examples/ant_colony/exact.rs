//! The exact any-angle length: Dijkstra's algorithm over the corners of obstacles that see one another.
//!
//! Obstacles are the blocked cells; their corners and edges may be touched, their interiors not entered, and there is no way
//! between two that touch at a corner. A shortest path turns at convex corners only: lattice points around which exactly one
//! cell is blocked. Lengths in cells, between centres of cells.

use agv_nav::core::grid::{Cell, CellState, Grid};

/// Rounding of lattice coordinates.
const ROUNDING: f64 = 1e-9;

/// Shortest length from one free cell to another; infinite if there is no way.
pub(crate) fn any_angle_length(map: &Grid<CellState>, start: Cell, goal: Cell) -> f64 {
    let (width, height) = (map.layout().width() as i32, map.layout().height() as i32);
    let centre = |cell: Cell| (f64::from(cell.x) + 0.5, f64::from(cell.y) + 0.5);
    let corners = (1..height).flat_map(|y| (1..width).map(move |x| (x, y))).filter(|&(x, y)| {
        let around = [(x, y), (x - 1, y), (x, y - 1), (x - 1, y - 1)];
        around.iter().filter(|&&(x, y)| is_blocked(map, x, y)).count() == 1
    });
    let mut points = vec![centre(start), centre(goal)];
    points.extend(corners.map(|(x, y)| (f64::from(x), f64::from(y))));
    let between = |a: usize, b: usize| (points[a].0 - points[b].0).hypot(points[a].1 - points[b].1);
    let mut lengths = vec![f64::INFINITY; points.len()];
    let mut settled = vec![false; points.len()];
    lengths[0] = 0.0;
    // A* with the straight line to the goal; the few hundred points need no queue.
    loop {
        let open = (0..points.len()).filter(|&i| !settled[i] && lengths[i].is_finite());
        let Some(node) = open.min_by(|&a, &b| (lengths[a] + between(a, 1)).total_cmp(&(lengths[b] + between(b, 1))))
        else {
            return f64::INFINITY;
        };
        if node == 1 {
            return lengths[1];
        }
        settled[node] = true;
        for next in 1..points.len() {
            let length = lengths[node] + between(node, next);
            if !settled[next] && length < lengths[next] && is_seen(map, points[node], points[next]) {
                lengths[next] = length;
            }
        }
    }
}

fn is_blocked(map: &Grid<CellState>, x: i32, y: i32) -> bool {
    map.get(Cell::new(x, y)) != Some(&CellState::Free)
}

/// Whether the segment enters no blocked cell and passes between no two that touch.
fn is_seen(map: &Grid<CellState>, a: (f64, f64), b: (f64, f64)) -> bool {
    let (dx, dy) = (b.0 - a.0, b.1 - a.1);
    // Along a line of the lattice one side must be free all the way.
    if dx == 0.0 && a.0.fract() == 0.0 || dy == 0.0 && a.1.fract() == 0.0 {
        let along_x = dy == 0.0;
        let (from, to) = if along_x { (a.0.min(b.0), a.0.max(b.0)) } else { (a.1.min(b.1), a.1.max(b.1)) };
        let line = if along_x { a.1 } else { a.0 } as i32;
        let sides = |i: i32| if along_x { [(i, line), (i, line - 1)] } else { [(line, i), (line - 1, i)] };
        let mut cells = (from.floor() as i32)..(to.ceil() as i32);
        return cells.all(|i| !sides(i).iter().all(|&(x, y)| is_blocked(map, x, y))) && passes_no_pinch(map, a, b);
    }
    let (low, high) = (a.1.min(b.1), a.1.max(b.1));
    for y in (low + ROUNDING).floor() as i32..(high - ROUNDING).ceil().max((low + ROUNDING).floor() + 1.0) as i32 {
        // Part of the segment in this row of cells.
        let (bottom, top) = (low.max(f64::from(y)), high.min(f64::from(y + 1)));
        let x_at = |y: f64| if dy == 0.0 { a.0 } else { a.0 + (y - a.1) / dy * dx };
        let (p, q) = if dy == 0.0 { (a.0, b.0) } else { (x_at(bottom), x_at(top)) };
        let (left, right) = (p.min(q), p.max(q));
        for x in (left + ROUNDING).floor() as i32..(right - ROUNDING).ceil() as i32 {
            if is_blocked(map, x, y) {
                return false;
            }
        }
        // A vertical piece inside a column.
        if right - left < ROUNDING && is_blocked(map, left.floor() as i32, y) {
            return false;
        }
    }
    passes_no_pinch(map, a, b)
}

/// Whether no lattice point strictly inside the segment lies between two blocked cells that touch there.
fn passes_no_pinch(map: &Grid<CellState>, a: (f64, f64), b: (f64, f64)) -> bool {
    let (dx, dy) = (b.0 - a.0, b.1 - a.1);
    let steps = dx.abs().max(dy.abs());
    let along_x = dx.abs() >= dy.abs();
    let (from, to) = if along_x { (a.0.min(b.0), a.0.max(b.0)) } else { (a.1.min(b.1), a.1.max(b.1)) };
    if steps == 0.0 {
        return true;
    }
    ((from + ROUNDING).ceil() as i32..=(to - ROUNDING).floor() as i32).all(|i| {
        let other = if along_x { a.1 + (f64::from(i) - a.0) / dx * dy } else { a.0 + (f64::from(i) - a.1) / dy * dx };
        let j = other.round();
        if (other - j).abs() > ROUNDING || f64::from(i) - from < ROUNDING || to - f64::from(i) < ROUNDING {
            return true;
        }
        let (x, y) = if along_x { (i, j as i32) } else { (j as i32, i) };
        let blocked = |dx: i32, dy: i32| is_blocked(map, x + dx, y + dy);
        !(blocked(0, 0) && blocked(-1, -1) || blocked(-1, 0) && blocked(0, -1))
    })
}
