//! The samples by name.

/// A sample, for programs that let their users choose one.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Sample {
    /// [`character`](super::character())
    Character,
    /// [`statue`](super::statue())
    Statue,
    /// [`mechanical`](super::mechanical())
    Mechanical,
    /// [`terrain`](super::terrain())
    Terrain,
    /// [`vase`](super::vase())
    Vase,
}

impl Sample {
    /// All samples, the most telling first.
    pub const ALL: [Self; 5] = [Self::Character, Self::Statue, Self::Mechanical, Self::Terrain, Self::Vase];

    /// The name that users know it by: that of the function that makes it.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Character => "character",
            Self::Statue => "statue",
            Self::Mechanical => "mechanical",
            Self::Terrain => "terrain",
            Self::Vase => "vase",
        }
    }

    /// The sample of a name.
    pub fn from_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|sample| sample.name() == name)
    }

    /// What it is and what it is good for, in one line.
    pub const fn about(self) -> &'static str {
        match self {
            Self::Character => "a person with a skeleton, smooth weights and clips to walk and run",
            Self::Statue => "a scanned cat on a plinth: one closed surface with fine noise, any size",
            Self::Mechanical => "a gear on a ribbed flange: flat and round faces, sharp edges, holes, long triangles",
            Self::Terrain => "a mountain lake: a height field with an open boundary and vertex colours",
            Self::Vase => "a black-figure vase: smooth, with painted motifs and a texture seam",
        }
    }

    /// How many triangles show it well.
    pub const fn default_triangles(self) -> usize {
        match self {
            Self::Character => 40_000,
            Self::Statue => 300_000,
            Self::Mechanical => 30_000,
            Self::Terrain => 500_000,
            Self::Vase => 500_000,
        }
    }
}
