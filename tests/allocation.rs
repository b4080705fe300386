//! After warm-up, updates allocate nothing on the heap: a counting allocator proves it.
//!
//! A component is added by a call of [`count_allocations`] around its update.

mod scenes;

use agv_nav::core::{
    compute::Par,
    roles::{Correct, Localizer, PoseBelief, UpdateOutcome},
};
use agv_nav::nalgebra::Matrix3;
use std::alloc::{GlobalAlloc, Layout, System};
use std::cell::Cell;
use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};

/// The system's allocator, counting the calls of watched threads while [`COUNTING`] is set. The only unsafe code of the
/// repository: an allocator cannot be written without.
struct CountingAllocator;

static COUNTING: AtomicBool = AtomicBool::new(false);
static ALLOCATIONS: AtomicUsize = AtomicUsize::new(0);
/// The counter is shared, so that workers of a pool are seen too: only one test may count at a time.
static TURN: Mutex<()> = Mutex::new(());

thread_local! {
    /// Whether this thread's allocations count: the test harness and other tests allocate when they like. A constant
    /// without a destructor, so that the allocator may read it at any time.
    static WATCHED: Cell<bool> = const { Cell::new(false) };
}

fn note() {
    if COUNTING.load(Ordering::Relaxed) && WATCHED.get() {
        ALLOCATIONS.fetch_add(1, Ordering::Relaxed);
    }
}

// SAFETY: every call is passed to the system's allocator as it came; counting touches no memory that it manages.
unsafe impl GlobalAlloc for CountingAllocator {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        note();
        // SAFETY: the caller's promises are those of the system's allocator.
        unsafe { System.alloc(layout) }
    }

    unsafe fn alloc_zeroed(&self, layout: Layout) -> *mut u8 {
        note();
        // SAFETY: as above.
        unsafe { System.alloc_zeroed(layout) }
    }

    unsafe fn realloc(&self, pointer: *mut u8, layout: Layout, new_size: usize) -> *mut u8 {
        note();
        // SAFETY: as above.
        unsafe { System.realloc(pointer, layout, new_size) }
    }

    unsafe fn dealloc(&self, pointer: *mut u8, layout: Layout) {
        // SAFETY: as above.
        unsafe { System.dealloc(pointer, layout) }
    }
}

#[global_allocator]
static ALLOCATOR: CountingAllocator = CountingAllocator;

/// Allocations of this thread, and of others that are watched, during `body`. The caller holds [`TURN`].
fn count_allocations(body: impl FnOnce()) -> usize {
    ALLOCATIONS.store(0, Ordering::SeqCst);
    WATCHED.set(true);
    COUNTING.store(true, Ordering::SeqCst);
    body();
    COUNTING.store(false, Ordering::SeqCst);
    WATCHED.set(false);
    ALLOCATIONS.load(Ordering::SeqCst)
}

/// A test that failed while it held its turn must not fail the others.
fn wait_for_turn() -> std::sync::MutexGuard<'static, ()> {
    TURN.lock().unwrap_or_else(std::sync::PoisonError::into_inner)
}

#[test]
fn the_counter_counts() {
    let _turn = wait_for_turn();
    assert!(count_allocations(|| drop(std::hint::black_box(vec![1_u8; 100]))) >= 1);
}

#[test]
fn monte_carlo_localisation_allocates_nothing() {
    let drive = scenes::circle(30);
    let _turn = wait_for_turn();
    let mut filter = scenes::scan_filter(2000, Par::Seq);
    filter.initialize(&PoseBelief::around(scenes::start(), Matrix3::identity() * 0.04)).unwrap();
    let mut resampled = false;
    let mut run = |steps: &[_]| {
        for (motion, scan) in steps {
            filter.predict(motion).unwrap();
            assert_eq!(filter.update(scan), Ok(UpdateOutcome::Applied));
            std::hint::black_box(filter.estimate());
            resampled |= filter.diagnostics().resampled;
        }
    };
    run(&drive[..3]);
    assert_eq!(count_allocations(|| run(&drive[3..])), 0);
    assert!(resampled, "the drive must exercise resampling");
}

#[test]
fn monte_carlo_localisation_allocates_nothing_inside_a_pool() {
    let drive = scenes::circle(30);
    let _turn = wait_for_turn();
    let pool = rayon::ThreadPoolBuilder::new().num_threads(2).build().unwrap();
    let mut filter = scenes::scan_filter(2000, Par::threads(2));
    filter.initialize(&PoseBelief::around(scenes::start(), Matrix3::identity() * 0.04)).unwrap();
    let mut run = |steps: &[_]| {
        for (motion, scan) in steps {
            filter.predict(motion).unwrap();
            assert_eq!(filter.update(scan), Ok(UpdateOutcome::Applied));
        }
    };
    pool.broadcast(|_| WATCHED.set(true));
    let count = pool.install(|| {
        run(&drive[..10]);
        count_allocations(|| run(&drive[10..]))
    });
    // The workers of a dropped pool end when they like, perhaps in the next test's turn.
    pool.broadcast(|_| WATCHED.set(false));
    assert_eq!(count, 0);
}
