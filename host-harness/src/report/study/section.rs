//! The sections of the page, in their order.

/// What the page has a heading and a link for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Section {
    /// Rate and distortion.
    Rate,
    /// What the paper says, and what is found here.
    Claims,
    /// Quality at M = 16.
    TableOne,
    /// Quality by M.
    TableTwo,
    /// Speed.
    TableThree,
    /// Segmentation and optical flow.
    Perception,
    /// Densities and regimes.
    Density,
    /// What is measured.
    Sources,
}

impl Section {
    /// All of them.
    pub const ALL: [Self; 8] = [
        Self::Rate,
        Self::Claims,
        Self::TableOne,
        Self::TableTwo,
        Self::TableThree,
        Self::Perception,
        Self::Density,
        Self::Sources,
    ];

    /// What links lead to.
    #[must_use]
    pub const fn id(self) -> &'static str {
        match self {
            Self::Rate => "rate",
            Self::Claims => "claims",
            Self::TableOne => "table-one",
            Self::TableTwo => "table-two",
            Self::TableThree => "table-three",
            Self::Perception => "perception",
            Self::Density => "density",
            Self::Sources => "sources",
        }
    }

    /// Its heading.
    #[must_use]
    pub const fn title(self) -> &'static str {
        match self {
            Self::Rate => "Rate and distortion",
            Self::Claims => "The paper's claims",
            Self::TableOne => "Table I",
            Self::TableTwo => "Table II",
            Self::TableThree => "Table III",
            Self::Perception => "Tables IV and V",
            Self::Density => "Densities",
            Self::Sources => "Sources",
        }
    }
}
