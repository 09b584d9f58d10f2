//! `report.html` of a diagnosis of the cut.

use super::cut_files::CutFiles;
use super::page::page;
use crate::diagnosis::cut::result::CutDiagnosis;

/// The page.
#[must_use]
pub fn cut_page(diagnosis: &CutDiagnosis, _files: &CutFiles<'_>) -> String {
    page(diagnosis.verdict.name(), "")
}
