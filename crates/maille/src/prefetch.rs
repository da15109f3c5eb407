//! Telling the processor what memory will be needed soon.
//!
//! Collapses come in order of cost, which jumps all over the mesh: without this, more than half of the time of a large
//! simplification is spent waiting for memory, although the queue knows many steps ahead what will be looked at.

/// Starts loading an element into the cache; nothing happens for an index that is out of range, or on processors for
/// which no instruction is known here.
#[inline]
pub(crate) fn prefetch<T>(slice: &[T], index: usize) {
    #[cfg(all(target_arch = "x86_64", not(miri)))]
    if let Some(element) = slice.get(index) {
        use std::arch::x86_64::{_MM_HINT_T0, _mm_prefetch};
        let address = std::ptr::from_ref(element).cast::<i8>();
        // SAFETY: a prefetch only hints; it never faults and changes nothing that the program can see. Both addresses
        // lie within the element.
        unsafe {
            _mm_prefetch::<_MM_HINT_T0>(address);
            if size_of::<T>() > 64 {
                _mm_prefetch::<_MM_HINT_T0>(address.add(64));
            }
        }
    }
    #[cfg(not(all(target_arch = "x86_64", not(miri))))]
    let _ = (slice, index);
}
