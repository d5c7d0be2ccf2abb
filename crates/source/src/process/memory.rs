//! Memory of a child process.

use std::process::Child;

/// Resident memory of a child and the processes below it, in bytes; on Windows of the child alone. None on other systems, and if the
/// child has ended. Memory that processes share counts for each.
#[cfg(target_os = "linux")]
pub fn resident(child: &Child) -> Option<u64> {
    let mut processes = vec![child.id()];
    let mut total = None;
    // a process may end meanwhile, and its number may be another's
    while let Some(process) = processes.pop().filter(|_| processes.len() < MOST) {
        total = resident_of(process).map_or(total, |bytes| Some(total.unwrap_or(0) + bytes));
        processes.extend(children(process));
    }
    total
}

/// Processes that are counted at most.
#[cfg(target_os = "linux")]
const MOST: usize = 4096;

#[cfg(target_os = "linux")]
fn resident_of(process: u32) -> Option<u64> {
    let status = std::fs::read_to_string(format!("/proc/{process}/status")).ok()?;
    let line = status.lines().find_map(|line| line.strip_prefix("VmRSS:"))?;
    let kibibytes: u64 = line.trim().strip_suffix("kB")?.trim_end().parse().ok()?;
    Some(1024 * kibibytes)
}

/// Children of all threads of a process; none on a kernel that does not list them.
#[cfg(target_os = "linux")]
fn children(process: u32) -> Vec<u32> {
    let threads = std::fs::read_dir(format!("/proc/{process}/task")).into_iter().flatten().flatten();
    let lists = threads.filter_map(|thread| std::fs::read_to_string(thread.path().join("children")).ok());
    lists.flat_map(|list| list.split_whitespace().filter_map(|child| child.parse().ok()).collect::<Vec<_>>()).collect()
}

/// Resident memory of a child in bytes.
#[cfg(windows)]
pub fn resident(child: &Child) -> Option<u64> {
    use std::{ffi::c_void, os::windows::io::AsRawHandle};

    /// `PROCESS_MEMORY_COUNTERS`.
    #[repr(C)]
    #[derive(Default)]
    struct MemoryCounters {
        size: u32,
        page_faults: u32,
        peak_working_set: usize,
        working_set: usize,
        of_quotas_and_page_file: [usize; 6],
    }
    #[link(name = "kernel32")]
    unsafe extern "system" {
        fn K32GetProcessMemoryInfo(process: *mut c_void, counters: *mut MemoryCounters, size: u32) -> i32;
    }

    let size = size_of::<MemoryCounters>() as u32;
    let mut counters = MemoryCounters { size, ..MemoryCounters::default() };
    // SAFETY: the handle is open as long as the child lives, and the structure has the stated size
    let succeeded = unsafe { K32GetProcessMemoryInfo(child.as_raw_handle(), &mut counters, size) };
    (succeeded != 0).then_some(counters.working_set as u64)
}

/// None: this system has no simple way to measure a child.
#[cfg(not(any(target_os = "linux", windows)))]
pub fn resident(_: &Child) -> Option<u64> {
    None
}

#[cfg(all(test, target_os = "linux"))]
mod tests {
    use super::*;
    use std::{
        io::{BufRead, BufReader},
        process::{Command, Stdio},
    };

    /// Kilobytes of a text in the memory of a shell's child.
    fn measured(kilobytes: usize) -> u64 {
        let script = format!("sh -c 'x=$(head -c {kilobytes}000 /dev/zero | tr \"\\0\" x); echo; read end'; :");
        let mut command = Command::new("sh");
        command.args(["-c", &script]).stdin(Stdio::piped()).stdout(Stdio::piped());
        let mut child = command.spawn().unwrap();
        let mut line = String::new();
        BufReader::new(child.stdout.take().unwrap()).read_line(&mut line).unwrap();
        let found = resident(&child).unwrap();
        child.kill().unwrap();
        child.wait().unwrap();
        assert_eq!(resident(&child), None);
        found
    }

    #[test]
    fn memory_of_grandchildren_counts() {
        let (small, large) = (measured(1), measured(30_000));
        assert!(small > 100_000 && large > small + 25_000_000, "{small} {large}");
    }
}
