//! The comparisons mean something only if the loops really run on the threads that are said.

use agv_nav::core::compute::Par;
use std::{collections::HashSet, sync::Mutex, thread, time::Duration};

#[test]
fn loops_use_the_pool_with_rayon_and_the_calling_thread_without() {
    let seen = Mutex::new(HashSet::new());
    let pool = rayon::ThreadPoolBuilder::new().num_threads(2).build().unwrap();
    let mut data = [0_u8; 200];
    pool.install(|| {
        Par::threads(2).for_each_chunk(data.as_mut_slice(), 1, |_, _| {
            seen.lock().unwrap().insert(thread::current().id());
            thread::sleep(Duration::from_millis(1));
        });
    });
    let threads = if cfg!(feature = "rayon") { 2 } else { 1 };
    assert_eq!(seen.lock().unwrap().len(), threads);
}
