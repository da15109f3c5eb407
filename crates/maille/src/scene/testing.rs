//! Numbers for the tests of this folder.

use proptest::prelude::*;

use super::view::{ScreenSize, View};

/// Any number at all, often one of those that make trouble.
pub(super) fn hostile() -> impl Strategy<Value = f64> {
    prop_oneof![
        prop::num::f64::ANY,
        prop::sample::select(vec![
            0.0,
            -0.0,
            -1.0,
            1.0,
            f64::NAN,
            f64::INFINITY,
            f64::NEG_INFINITY,
            f64::MIN_POSITIVE,
            5e-324
        ]),
        -10.0_f64..1000.0,
    ]
}

/// The size of a small object at a distance.
pub(super) fn at_distance(distance: f64) -> ScreenSize {
    ScreenSize { distance, ..View::new(1.0, 1080.0).screen_size([0.0; 3], [distance, 0.0, 0.0], 0.0) }
}
