//! Progress of long work, on standard error; nothing is shown where that is not a terminal.

use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};

/// A bar with the time that is left; it vanishes when it is dropped.
///
/// ```
/// let progress = agv_support::progress::Progress::new(3, "localising");
/// for scan in progress.over([1, 2, 3]) {
///     assert!(scan > 0);
/// }
/// ```
#[derive(Debug)]
pub struct Progress(ProgressBar);

impl Progress {
    /// A bar of `steps` steps.
    pub fn new(steps: usize, message: &'static str) -> Self {
        let bar = ProgressBar::with_draw_target(Some(steps as u64), ProgressDrawTarget::stderr());
        // The template is a constant; should indicatif refuse it, its own look serves.
        if let Ok(style) = ProgressStyle::with_template("{msg:>14} {bar:40} {pos}/{len} {eta}") {
            bar.set_style(style);
        }
        bar.set_message(message);
        Self(bar)
    }

    /// Says that a step is done.
    pub fn step(&self) {
        self.0.inc(1);
    }

    /// The items, each a step.
    pub fn over<I: IntoIterator>(&self, items: I) -> impl Iterator<Item = I::Item> {
        items.into_iter().inspect(|_| self.step())
    }
}

impl Drop for Progress {
    fn drop(&mut self) {
        self.0.finish_and_clear();
    }
}
