//! Inserting scans allocates nothing once the buffers have their size and the map does not grow.

use agv_core::{
    geometry::Se2,
    grid::{EvidenceGrid, GridLayout, InverseModelParams, OccupancyGrid, OccupancyParams},
    sensors::{LaserScan, ScanGeometry},
    time::Stamp,
};
use std::{
    alloc::{GlobalAlloc, Layout, System},
    sync::atomic::{AtomicUsize, Ordering},
};

/// The system's allocator, counting.
struct Counting;

static ALLOCATIONS: AtomicUsize = AtomicUsize::new(0);

// SAFETY: every call goes to the system's allocator as it came.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        ALLOCATIONS.fetch_add(1, Ordering::Relaxed);
        unsafe { System.alloc(layout) }
    }

    unsafe fn dealloc(&self, pointer: *mut u8, layout: Layout) {
        unsafe { System.dealloc(pointer, layout) }
    }
}

#[global_allocator]
static ALLOCATOR: Counting = Counting;

/// The only test of its file, as the counter is the process's.
#[test]
fn inserting_does_not_allocate_after_the_first_scan() {
    let layout = GridLayout::new(400, 400, 0.05, Se2::new(-10.0, -10.0, 0.0)).unwrap();
    let mut map = EvidenceGrid::new(layout, InverseModelParams::default()).unwrap();
    let mut live = OccupancyGrid::new(layout, OccupancyParams::default()).unwrap();
    let scan = LaserScan::new(Stamp::default(), ScanGeometry::default(), vec![7.3; 1081]).unwrap();
    map.insert_scan(&scan, &Se2::default()).unwrap();
    live.insert_scan(&scan, &Se2::default()).unwrap();

    // The harness may allocate at any time in its own thread: the least of several trials counts.
    let least = (0..5).map(|trial| {
        let before = ALLOCATIONS.load(Ordering::Relaxed);
        for i in 0..20 {
            let pose = Se2::new(0.01 * f64::from(i), 0.02 * f64::from(trial), 0.1 * f64::from(i));
            map.insert_scan(&scan, &pose).unwrap();
            live.insert_scan(&scan, &pose).unwrap();
        }
        ALLOCATIONS.load(Ordering::Relaxed) - before
    });
    assert_eq!(least.min(), Some(0));
}
