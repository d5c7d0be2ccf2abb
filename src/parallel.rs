//! Trainings in parallel: many small ones use the cores better than one after the other on all of them.

use std::sync::{
    Mutex, PoisonError,
    atomic::{AtomicUsize, Ordering},
};

/// Calls a function for each number, on one thread for each core; each call uses a single thread.
pub fn side_by_side<T: Send>(numbers: &[usize], function: impl Fn(usize) -> T + Sync) -> Vec<(usize, T)> {
    let (next, results) = (AtomicUsize::new(0), Mutex::new(Vec::new()));
    std::thread::scope(|scope| {
        for _ in 0..rayon::current_num_threads().min(numbers.len()) {
            scope.spawn(|| {
                let alone = rayon::ThreadPoolBuilder::new().num_threads(1).build();
                while let Some(&number) = numbers.get(next.fetch_add(1, Ordering::Relaxed)) {
                    let result = match &alone {
                        Ok(pool) => pool.install(|| function(number)),
                        // no pool of one thread: the trial takes more than its share
                        Err(_) => function(number),
                    };
                    results.lock().unwrap_or_else(PoisonError::into_inner).push((number, result));
                }
            });
        }
    });
    results.into_inner().unwrap_or_else(PoisonError::into_inner)
}
