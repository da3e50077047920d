//! The sections of the page, in their order.

/// A section with a heading and a link.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Section {
    /// Rate and distortion.
    Rate,
    /// The paper's claims, and whether they hold here.
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
    /// The sources measured.
    Sources,
}

impl Section {
    /// All sections, in their order.
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

    /// Returns the anchor of the section.
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

    /// Returns the heading.
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
