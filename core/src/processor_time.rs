//! Processor time of this process or thread.

/// Clock of processor time.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ProcessorClock {
    /// All threads of this process together.
    Process,
    /// The calling thread.
    Thread,
}

/// Processor time since a moment. Unlike wall time, it does not grow while other work has the processor.
#[derive(Clone, Copy, Debug)]
pub struct ProcessorTimer {
    clock: ProcessorClock,
    began: f64,
}

impl ProcessorTimer {
    /// A timer that begins now.
    pub fn start(clock: ProcessorClock) -> Self {
        Self { clock, began: now(clock) }
    }

    /// Processor time since the start in seconds; that of a thread must be read on the same thread.
    pub fn seconds(&self) -> f64 {
        (now(self.clock) - self.began).max(0.0)
    }
}

/// Seconds of a clock.
#[cfg(unix)]
fn now(clock: ProcessorClock) -> f64 {
    use rustix::time::{ClockId, clock_gettime};
    let time = clock_gettime(match clock {
        ProcessorClock::Process => ClockId::ProcessCPUTime,
        ProcessorClock::Thread => ClockId::ThreadCPUTime,
    });
    time.tv_sec as f64 + 1e-9 * time.tv_nsec as f64
}

/// Seconds of a clock, in the kernel and outside.
#[cfg(windows)]
fn now(clock: ProcessorClock) -> f64 {
    use windows_sys::Win32::{
        Foundation::FILETIME,
        System::Threading::{GetCurrentProcess, GetCurrentThread, GetProcessTimes, GetThreadTimes},
    };
    let mut times = [FILETIME { dwLowDateTime: 0, dwHighDateTime: 0 }; 4];
    let [creation, exit, kernel, user] = &mut times;
    // SAFETY: both functions only write the four times; the handles are constants that need no closing
    unsafe {
        match clock {
            ProcessorClock::Process => GetProcessTimes(GetCurrentProcess(), creation, exit, kernel, user),
            ProcessorClock::Thread => GetThreadTimes(GetCurrentThread(), creation, exit, kernel, user),
        }
    };
    let ticks = |time: &FILETIME| (u64::from(time.dwHighDateTime) << 32) | u64::from(time.dwLowDateTime);
    // of 100 ns
    1e-7 * (ticks(&times[2]) + ticks(&times[3])) as f64
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::time::{Duration, Instant};

    /// Works for a share of a second of the calling thread's processor time.
    fn work(seconds: f64) {
        let timer = ProcessorTimer::start(ProcessorClock::Thread);
        while timer.seconds() < seconds {
            std::hint::black_box((0..1000).sum::<u64>());
        }
    }

    #[test]
    fn waiting_takes_no_processor_time() {
        let (thread, wall) = (ProcessorTimer::start(ProcessorClock::Thread), Instant::now());
        std::thread::sleep(Duration::from_millis(50));
        assert!(thread.seconds() < 0.5 * wall.elapsed().as_secs_f64());
    }

    #[test]
    fn processor_time_of_a_process_includes_that_of_its_threads() {
        let (process, thread) = [ProcessorClock::Process, ProcessorClock::Thread].map(ProcessorTimer::start).into();
        std::thread::scope(|scope| {
            scope.spawn(|| work(0.02));
        });
        assert!(process.seconds() >= 0.02 && thread.seconds() < 0.02);
    }
}
