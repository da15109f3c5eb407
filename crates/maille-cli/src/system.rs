//! What the operating system knows about this process.

/// Most memory this process has held at once, in bytes; `None` where the system does not tell.
pub(crate) fn peak_bytes() -> Option<u64> {
    status("VmHWM:")
}

/// Memory this process holds now, in bytes; `None` where the system does not tell.
pub(crate) fn held_bytes() -> Option<u64> {
    status("VmRSS:")
}

/// Linux: "VmHWM:   12345 kB"
fn status(name: &str) -> Option<u64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = status.lines().find_map(|line| line.strip_prefix(name))?;
    let kibibytes: u64 = line.split_whitespace().next()?.parse().ok()?;
    Some(kibibytes * 1024)
}

/// Lets [`peak_bytes`] start anew from what is held now; where the system cannot, the peak stays what it was.
pub(crate) fn reset_peak() {
    // Linux: 5 resets the high-water mark of the resident set (proc(5), clear_refs)
    let _ = std::fs::write("/proc/self/clear_refs", "5");
}

#[cfg(test)]
mod tests {
    #[cfg(target_os = "linux")]
    #[test]
    fn peak_covers_what_was_touched() {
        let before = super::peak_bytes().expect("Linux tells");
        let touched = vec![1_u8; 64 << 20];
        assert!(super::peak_bytes().expect("Linux tells") >= (64 << 20) * usize::from(touched[5]) as u64);
        assert!(before > 0);
    }
}
