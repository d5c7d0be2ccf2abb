//! Threads that stay awake between the pieces of a step.
//!
//! A step takes some ten microseconds, and the threads have to meet twice in it. Members of a team wait for work by
//! spinning for a short while, then by offering their core to others, and at last asleep. Meeting therefore costs a
//! fraction of a microsecond while the team has its cores to itself, and little more otherwise.
//!
//! Work is a number of items, each done once, by whichever member comes for it first. A member that is late because its
//! core was taken away is not waited for: the others do its items. Results therefore must not depend on who does an item.

use std::{
    cell::UnsafeCell,
    ops::Range,
    panic::{AssertUnwindSafe, catch_unwind},
    sync::{
        Arc,
        atomic::{AtomicBool, AtomicU64, AtomicUsize, Ordering},
    },
    thread::{self, JoinHandle, Thread},
};

/// The caller and `members - 1` separate threads.
pub(super) struct Team {
    shared: Arc<Shared>,
    threads: Vec<JoinHandle<()>>,
    sleepers: Vec<(Thread, Arc<AtomicBool>)>,
    round: u32,
    /// `true` if the caller does all items itself.
    alone: bool,
}

type TeamWork<'a> = dyn Fn(usize, usize) + Sync + 'a;

/// On separate cache lines: frequent writes would slow down the reading of neighboring values.
#[repr(align(128))]
struct Alone<T>(T);

struct Shared {
    /// The round in the upper half, the number of items not yet taken in the lower half. Taking one is a decrement, and
    /// who succeeds owns an item of just this round.
    open: Alone<AtomicU64>,
    /// Items done in this round.
    done: Alone<AtomicUsize>,
    /// Written by the caller between rounds, read by who owns an item.
    work: UnsafeCell<Option<*const TeamWork<'static>>>,
    failed: AtomicBool,
    dismissed: AtomicBool,
}

// SAFETY: `work` is written only while no item is open or under way, and read only by an owner of an item; the release
// and acquire operations on `open` and `done` order the two. What it points to is `Sync`.
unsafe impl Sync for Shared {}
// SAFETY: as above
unsafe impl Send for Shared {}

/// Number of looks before a waiting thread offers its core to others, some 10 µs, ...
const SPINS: u32 = 300;
/// ... and before a member goes to sleep.
const YIELDS: u32 = 100;

impl Team {
    pub(super) fn new(members: usize) -> Self {
        let shared = Arc::new(Shared {
            open: Alone(AtomicU64::new(0)),
            done: Alone(AtomicUsize::new(0)),
            work: UnsafeCell::new(None),
            failed: AtomicBool::new(false),
            dismissed: AtomicBool::new(false),
        });
        let (mut threads, mut sleepers) = (Vec::new(), Vec::new());
        for member in 1..members {
            let (shared, asleep) = (Arc::clone(&shared), Arc::new(AtomicBool::new(false)));
            let flag = Arc::clone(&asleep);
            // without the thread, the others do its work
            if let Ok(thread) = thread::Builder::new().spawn(move || shared.serve(member, &flag)) {
                sleepers.push((thread.thread().clone(), asleep));
                threads.push(thread);
            }
        }
        let alone = threads.is_empty();
        Self { shared, threads, sleepers, round: 0, alone }
    }

    /// Sets whether the caller does all items itself from now on.
    pub(super) fn set_alone(&mut self, alone: bool) {
        self.alone = alone || self.threads.is_empty();
    }

    /// Most members that can be at work.
    pub(super) fn members(&self) -> usize {
        self.threads.len() + 1
    }

    /// Calls `work(member, item)` once for every item below `items`, on all members, and returns when all are done.
    /// `member` is below [`members`](Self::members); no two calls with the same one overlap.
    ///
    /// # Panics
    /// If a call panicked.
    pub(super) fn for_each(&mut self, items: usize, work: impl Fn(usize, usize) + Sync) {
        if self.alone || items <= 1 {
            return (0..items).for_each(|item| work(0, item));
        }
        let work: &TeamWork = &work;
        let pointer: *const TeamWork<'_> = work;
        // SAFETY: only the lifetime is extended. Nobody reads the pointer after the last item is done, and that is
        // waited for before `work` goes out of scope
        let pointer: *const TeamWork<'static> = unsafe { std::mem::transmute(pointer) };
        let shared = &*self.shared;
        // SAFETY: all items of the round before are done, so nobody reads it now
        unsafe { *shared.work.get() = Some(pointer) };
        shared.done.0.store(0, Ordering::Relaxed);
        self.round = self.round.wrapping_add(1);
        shared.open.0.store(u64::from(self.round) << 32 | items as u64, Ordering::SeqCst);
        for (thread, asleep) in &self.sleepers {
            if asleep.load(Ordering::SeqCst) {
                thread.unpark();
            }
        }
        shared.do_items(0);
        let mut looks = 0;
        while shared.done.0.load(Ordering::Acquire) < items {
            wait(&mut looks);
        }
        assert!(!shared.failed.load(Ordering::Relaxed), "a member of the team panicked");
    }
}

impl Drop for Team {
    fn drop(&mut self) {
        self.shared.dismissed.store(true, Ordering::SeqCst);
        for thread in self.threads.drain(..) {
            thread.thread().unpark();
            // a panic of a member has been reported already
            let _ = thread.join();
        }
    }
}

impl Shared {
    /// A member's life.
    fn serve(&self, member: usize, asleep: &AtomicBool) {
        let mut looks = 0;
        while !self.dismissed.load(Ordering::Relaxed) {
            if self.do_items(member) {
                looks = 0;
            } else if looks < SPINS + YIELDS {
                wait(&mut looks);
            } else {
                asleep.store(true, Ordering::SeqCst);
                // whoever opened a round before it could see the flag does not wake us, so look again
                if self.open.0.load(Ordering::SeqCst) as u32 == 0 && !self.dismissed.load(Ordering::SeqCst) {
                    thread::park();
                }
                asleep.store(false, Ordering::SeqCst);
                looks = 0;
            }
        }
    }

    /// Takes and does items until none is left; whether there was one.
    fn do_items(&self, member: usize) -> bool {
        let mut any = false;
        let mut open = self.open.0.load(Ordering::Acquire);
        while open as u32 > 0 {
            match self.open.0.compare_exchange_weak(open, open - 1, Ordering::AcqRel, Ordering::Acquire) {
                Err(now) => open = now,
                Ok(_) => {
                    any = true;
                    let item = (open - 1) as u32 as usize;
                    // SAFETY: we own an item of this round, so its work is in place and stays until we say it is done
                    let call = || unsafe { (*self.work.get()).map(|work| (*work)(member, item)) };
                    if catch_unwind(AssertUnwindSafe(call)).is_err() {
                        self.failed.store(true, Ordering::Relaxed);
                    }
                    self.done.0.fetch_add(1, Ordering::Release);
                    open = self.open.0.load(Ordering::Acquire);
                }
            }
        }
        any
    }
}

fn wait(looks: &mut u32) {
    *looks += 1;
    if *looks <= SPINS { std::hint::spin_loop() } else { thread::yield_now() }
}

/// A slice that several members write to, each to a separate range.
pub(super) struct Divided<'a, T> {
    begin: *mut T,
    len: usize,
    slice: std::marker::PhantomData<&'a mut [T]>,
}

// SAFETY: it hands out exclusive access to ranges, as `chunks_mut` does; its user keeps them apart
unsafe impl<T: Send> Sync for Divided<'_, T> {}

impl<'a, T> Divided<'a, T> {
    pub(super) fn new(slice: &'a mut [T]) -> Self {
        Self { begin: slice.as_mut_ptr(), len: slice.len(), slice: std::marker::PhantomData }
    }

    /// The elements in `range`.
    ///
    /// # Safety
    /// As long as the result lives, no other range that overlaps with this one is requested.
    ///
    /// # Panics
    /// If the range is not within the slice.
    #[expect(clippy::mut_from_ref, reason = "the caller keeps the ranges apart")]
    pub(super) unsafe fn range(&self, range: Range<usize>) -> &mut [T] {
        assert!(range.start <= range.end && range.end <= self.len, "range within the slice");
        // SAFETY: within the slice that is exclusively borrowed for 'a, and apart from other ranges
        unsafe { std::slice::from_raw_parts_mut(self.begin.add(range.start), range.len()) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::time::Duration;

    #[test]
    fn every_item_is_done_once_in_every_round() {
        let mut team = Team::new(3);
        for items in (0..2_000).map(|round| round % 7) {
            let mut counts = vec![0; items];
            let divided = Divided::new(&mut counts);
            // SAFETY: one element for each item
            team.for_each(items, |_, item| unsafe { divided.range(item..item + 1)[0] += item + 1 });
            assert!(counts.iter().enumerate().all(|(item, count)| *count == item + 1), "{counts:?}");
        }
    }

    #[test]
    fn members_that_fell_asleep_are_woken() {
        let mut team = Team::new(2);
        for _ in 0..3 {
            thread::sleep(Duration::from_millis(30));
            // each item waits for the other one, so it takes two members
            let arrived = AtomicUsize::new(0);
            team.for_each(2, |_, _| {
                arrived.fetch_add(1, Ordering::SeqCst);
                while arrived.load(Ordering::SeqCst) < 2 {
                    thread::yield_now();
                }
            });
        }
    }

    #[test]
    fn a_caller_that_is_alone_does_everything() {
        let mut team = Team::new(3);
        for alone in [true, false, true] {
            team.set_alone(alone);
            let done = AtomicUsize::new(0);
            team.for_each(50, |member, _| {
                assert!(member == 0 || !alone);
                done.fetch_add(1, Ordering::Relaxed);
            });
            assert_eq!(done.into_inner(), 50);
        }
    }

    #[test]
    #[should_panic(expected = "a member of the team panicked")]
    fn a_panic_of_a_member_reaches_the_caller() {
        Team::new(2).for_each(5, |_, item| assert!(item != 3));
    }
}
