//! What every start puts on record: a history that was replaced, the start itself, settings that changed.

use super::clock;
use super::handle::Handle;
use crate::config::service::{ServiceConfig, TurretConfig};
use crate::store::{AuditEntry, OpenReport, StoreError, StoreReader, StoreWriter};
use crate::telemetry::EventKind;
use std::sync::Arc;

/// What it needs.
pub(super) struct FirstEntries {
    pub(super) config: Arc<ServiceConfig>,
    pub(super) writer: StoreWriter,
    pub(super) reader: StoreReader,
    pub(super) report: OpenReport,
}

impl FirstEntries {
    /// Waits for the disk as long as it takes; until then nobody raises the mode.
    pub(super) async fn tell(self, handle: Handle) {
        if let Some(damage) = &self.report.damage {
            let moved = damage.moved_to.display();
            let text = format!(
                "the history was damaged ({}); it is now {moved} and a new one was begun",
                damage.reason
            );
            let lost = self.report.missing.as_ref().map(|m| format!("; {}", m.sentence()));
            handle.report(EventKind::HistoryReplaced, text + &lost.unwrap_or_default()).await;
        } else if let Some(missing) = &self.report.missing {
            let kept = self.report.log_kept.as_ref().map(|l| format!("; the log is kept as {}", l.display()));
            handle.report(EventKind::HistoryCut, missing.sentence() + &kept.unwrap_or_default()).await;
        } else if !self.report.spoilt_notes.is_empty() {
            let spoilt = &self.report.spoilt_notes;
            let known = if spoilt.len() > 1 {
                "nobody knows whether rows are missing"
            } else {
                "by the other copy no row is missing"
            };
            let text = format!("the note of how far the history was durable: {}; {known}", spoilt.join(", "));
            handle.report(EventKind::HistoryCut, text).await;
        }
        let text = format!("stillcut {} started, epoch {}", env!("CARGO_PKG_VERSION"), self.report.epoch);
        handle.report(EventKind::ServiceStart, text).await;
        if let Err(error) = self.tell_settings(&handle).await {
            tracing::error!(event = "settings", "{error}");
        }
        handle.0.settled.cancel();
    }

    /// Puts the settings on record where they are others than at the start before: with the turret's limits,
    /// and who set them when.
    async fn tell_settings(&self, handle: &Handle) -> Result<(), StoreError> {
        let (hash, epoch) = (&handle.config().hash, self.report.epoch);
        let before = self.reader.settings_before(epoch).await?;
        if before.as_ref() != Some(hash) {
            let short = |hash: &str| hash.chars().take(12).collect::<String>();
            let limits = limits_in_words(&self.config.turret);
            if let Some(before) = &before {
                let text = format!("the settings were {}, are {}; {limits}", short(before), short(hash));
                handle.report(EventKind::ConfigChanged, text).await;
            }
            let entry = AuditEntry {
                wall_ns: clock::wall_ns(),
                actor: "service".into(),
                role: "service".into(),
                action: "settings".into(),
                detail: format!("SHA-256 {hash}; {limits}"),
            };
            self.writer.audit(entry).await?;
        }
        self.writer.note_settings(epoch, hash).await
    }
}

/// The commissioned limits for the record.
fn limits_in_words(turret: &TurretConfig) -> String {
    let who = match &turret.commissioned {
        Some((by, date)) => format!("limits of the turret by {by}, {date}"),
        None => "limits of the turret not commissioned".to_owned(),
    };
    format!(
        "{who}: pitch {} rad, offsets {:?} to {:?} m, speed {:?} m/s",
        turret.largest_pitch_difference_rad,
        turret.lowest_offset_m,
        turret.highest_offset_m,
        turret.speed_m_s
    )
}
