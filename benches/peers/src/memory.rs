//! Time and memory of a piece of work: a global allocator that counts, for Rust and for meshoptimizer's C++.

use std::alloc::{GlobalAlloc, Layout, System};
use std::ffi::c_void;
use std::sync::atomic::{AtomicUsize, Ordering::Relaxed};
use std::time::Instant;

/// What a piece of work took.
#[derive(Debug, Clone, Copy)]
pub struct Cost {
    /// By the clock.
    pub seconds: f64,
    /// Most bytes allocated at once beyond what was there before; `None` where it cannot be told.
    pub peak_bytes: Option<u64>,
}

/// Does a piece of work and tells what it took. Only one at a time: the count is that of the whole process.
pub fn measure<T>(work: impl FnOnce() -> T) -> (T, Cost) {
    let before = LIVE.load(Relaxed);
    PEAK.store(before, Relaxed);
    let start = Instant::now();
    let result = work();
    let seconds = start.elapsed().as_secs_f64();
    let peak = PEAK.load(Relaxed).saturating_sub(before);
    (result, Cost { seconds, peak_bytes: Some(peak as u64) })
}

/// Makes meshoptimizer take its memory where it is counted. To be called before it is used.
pub fn count_meshoptimizer() {
    // SAFETY: the two functions below are a matching pair, and nothing of meshoptimizer runs yet.
    unsafe { meshopt::ffi::meshopt_setAllocator(Some(allocate), Some(deallocate)) };
}

/// The system's allocator, counting the bytes asked for. A block that grows counts with its new size only.
struct Counting;

#[global_allocator]
static ALLOCATOR: Counting = Counting;

static LIVE: AtomicUsize = AtomicUsize::new(0);
static PEAK: AtomicUsize = AtomicUsize::new(0);

fn taken(bytes: usize) {
    let live = LIVE.fetch_add(bytes, Relaxed) + bytes;
    PEAK.fetch_max(live, Relaxed);
}

fn given_back(bytes: usize) {
    LIVE.fetch_sub(bytes, Relaxed);
}

// SAFETY: every call goes to the system's allocator as it came.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        taken(layout.size());
        // SAFETY: the caller keeps the contract of `alloc`.
        unsafe { System.alloc(layout) }
    }

    unsafe fn alloc_zeroed(&self, layout: Layout) -> *mut u8 {
        taken(layout.size());
        // SAFETY: the caller keeps the contract of `alloc_zeroed`.
        unsafe { System.alloc_zeroed(layout) }
    }

    unsafe fn dealloc(&self, block: *mut u8, layout: Layout) {
        given_back(layout.size());
        // SAFETY: the caller keeps the contract of `dealloc`.
        unsafe { System.dealloc(block, layout) }
    }

    unsafe fn realloc(&self, block: *mut u8, layout: Layout, size: usize) -> *mut u8 {
        given_back(layout.size());
        taken(size);
        // SAFETY: the caller keeps the contract of `realloc`.
        unsafe { System.realloc(block, layout, size) }
    }
}

/// In front of each block of meshoptimizer, holding its size; as long as the strictest alignment C++ asks for.
const HEADER: usize = 16;

fn layout(bytes: usize) -> Layout {
    let total = bytes.checked_add(HEADER).expect("meshoptimizer checks its sizes for overflow");
    Layout::from_size_align(total, HEADER).expect("no block is larger than the address space")
}

unsafe extern "C" fn allocate(bytes: usize) -> *mut c_void {
    let layout = layout(bytes);
    // SAFETY: the layout has room for the header at least, so its size is not zero; the header is written and jumped
    // over within it.
    unsafe {
        let block = std::alloc::alloc(layout);
        if block.is_null() {
            std::alloc::handle_alloc_error(layout);
        }
        block.cast::<usize>().write(bytes);
        block.add(HEADER).cast()
    }
}

unsafe extern "C" fn deallocate(block: *mut c_void) {
    if block.is_null() {
        return;
    }
    // SAFETY: the block comes from `allocate`, so its header is in front of it and tells its layout.
    unsafe {
        let block = block.cast::<u8>().sub(HEADER);
        let bytes = block.cast::<usize>().read();
        std::alloc::dealloc(block, layout(bytes));
    }
}
