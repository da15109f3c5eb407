//! Sorting numbers by some of their bits.

/// Numbers below which comparing is as fast.
const FEW: usize = 512;

/// Bits looked at in one pass.
const DIGIT: u32 = 11;

/// Sorts by the 32 bits from `low` on; equal ones keep their order. Linear: three passes of counting and moving, fewer
/// where the bits are all the same. `scratch` is memory to be used again.
pub(crate) fn sort_by_bits(entries: &mut Vec<u64>, low: u32, scratch: &mut Vec<u64>) {
    let key = |entry: u64| (entry >> low) as u32;
    if entries.len() < FEW {
        entries.sort_by_key(|&entry| key(entry));
        return;
    }
    let differing = entries.iter().fold(0, |bits, &entry| bits | (key(entry) ^ key(entries[0])));
    scratch.resize(entries.len(), 0);
    for shift in (0..u32::BITS).step_by(DIGIT as usize) {
        let digit = |entry: u64| (key(entry) >> shift) as usize & ((1 << DIGIT) - 1);
        if differing >> shift & ((1 << DIGIT) - 1) == 0 {
            continue;
        }
        let mut next = [0_usize; 1 << DIGIT];
        for &entry in entries.iter() {
            next[digit(entry)] += 1;
        }
        let mut sum = 0;
        for place in &mut next {
            sum += std::mem::replace(place, sum);
        }
        for &entry in entries.iter() {
            let place = &mut next[digit(entry)];
            scratch[*place] = entry;
            *place += 1;
        }
        std::mem::swap(entries, scratch);
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    proptest! {
        #[test]
        fn sorts_like_the_standard_library(
            seed in any::<u64>(), count in 0..2000_usize, mask in any::<u64>(), low in prop::sample::select(vec![0, 32]),
        ) {
            let mixed = |i: usize| (i as u64 ^ seed).wrapping_mul(0x9e37_79b9_7f4a_7c15).rotate_left(29) & mask;
            let mut entries: Vec<u64> = (0..count).map(mixed).collect();
            let mut expected = entries.clone();
            expected.sort_by_key(|&entry| (entry >> low) as u32);
            sort_by_bits(&mut entries, low, &mut Vec::new());
            prop_assert_eq!(entries, expected);
        }
    }
}
