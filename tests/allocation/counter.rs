//! The counting allocator, the one of the repository.
//!
//! Every thread counts for whom it was told to, and for nobody otherwise: tests run side by side, and what the test
//! harness allocates in its own threads is not seen.

use std::{
    alloc::{GlobalAlloc, Layout, System},
    cell::Cell,
    sync::atomic::{AtomicUsize, Ordering},
};

/// The system's allocator, counting. The only unsafe code of the repository: an allocator cannot be written without.
struct CountingAllocator;

thread_local! {
    // Neither initialised lazily nor dropped, so that the allocator may look at it at any time.
    static TALLY: Cell<Option<&'static AtomicUsize>> = const { Cell::new(None) };
}

fn note() {
    if let Some(tally) = TALLY.get() {
        tally.fetch_add(1, Ordering::Relaxed);
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

fn new_tally() -> &'static AtomicUsize {
    Box::leak(Box::default())
}

/// Allocations of the calling thread during `body`.
pub(crate) fn count(body: impl FnOnce()) -> usize {
    let tally = new_tally();
    let outer = TALLY.replace(Some(tally));
    body();
    TALLY.set(outer);
    tally.load(Ordering::SeqCst)
}

/// Runs `warm_up` and then `body` inside a pool of `threads`; allocations of all its threads during `body`.
pub(crate) fn count_in_pool(threads: usize, mut warm_up: impl FnMut() + Send, body: impl FnOnce() + Send) -> usize {
    let tally = new_tally();
    let builder = rayon::ThreadPoolBuilder::new().num_threads(threads);
    let pool = builder.start_handler(|_| TALLY.set(Some(tally))).build().unwrap();
    // A worker allocates when it first looks for work, which on a busy machine may be late.
    pool.broadcast(|_| ());
    pool.install(|| {
        warm_up();
        let before = tally.load(Ordering::SeqCst);
        body();
        tally.load(Ordering::SeqCst) - before
    })
}

#[test]
fn the_counter_counts_the_calls_of_its_thread() {
    let allocate = || drop(std::hint::black_box(vec![1_u8; 100]));
    assert_eq!(count(allocate), 1);
    assert_eq!(count(|| assert_eq!(count(allocate), 1)), 1, "the inner count's own tally");
    assert_eq!(count(|| ()), 0);
}

#[test]
fn the_counter_sees_the_workers_of_a_pool() {
    // Both halves allocate, whichever worker takes them.
    let allocate = || drop(std::hint::black_box(vec![1_u8; 100]));
    let both = || {
        rayon::join(allocate, allocate);
    };
    assert_eq!(count_in_pool(2, both, both), 2);
}
