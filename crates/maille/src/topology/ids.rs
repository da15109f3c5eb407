//! Names of elements: 32-bit indices that cannot be mistaken for one another.

macro_rules! id {
    ($(#[$doc:meta])* $name:ident, $letter:literal) => {
        $(#[$doc])*
        #[derive(Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
        pub struct $name(pub u32);

        impl $name {
            /// The number as an index into an array.
            pub fn index(self) -> usize {
                self.0 as usize
            }
        }

        impl std::fmt::Debug for $name {
            fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
                write!(f, concat!($letter, "{}"), self.0)
            }
        }
    };
}

id!(
    /// A vertex; printed as `v12`.
    VertexId, "v"
);
id!(
    /// A face; printed as `f3`.
    FaceId, "f"
);
id!(
    /// A corner of a face, and the half-edge that leaves it; printed as `c7`.
    CornerId, "c"
);
