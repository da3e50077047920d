//! What is done with counts beside printing them.

use clap::Args;

/// Counts are printed, and one of these.
#[derive(Debug, Clone, Copy, Args)]
pub struct Action {
    /// Save the counts, and write the tables of documents that show them
    #[arg(long, conflicts_with = "check")]
    pub save: bool,
    /// Compare with the saved counts, and fail if one has grown
    #[arg(long)]
    pub check: bool,
}
