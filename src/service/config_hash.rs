//! Hashes by which a configuration is known again.

use super::handle::ShownConfig;
use crate::config::service::ServiceConfig;
use sha2::{Digest as _, Sha256};

/// SHA-256 of what evidence is gathered with: the model, the method, the detection and the turret, but not
/// who set its limits and what was accepted.
pub(super) fn machine_hash(config: &ServiceConfig) -> String {
    let mut table: toml::Table = config.text.parse().unwrap_or_default();
    if let Some(toml::Value::Table(turret)) = table.get_mut("turret") {
        turret.retain(|key, _| !["limits_by", "limits_date", "accept"].contains(&key));
    }
    let mut hash = Sha256::new();
    for section in ["machine", "detection", "turret"] {
        hash.update(table.get(section).map(ToString::to_string).unwrap_or_default());
    }
    // A model that cannot be read now was read a moment ago: its path stands for it.
    let model = config.model.as_ref().and_then(|path| std::fs::read(path).ok());
    hash.update(model.unwrap_or_default());
    hash.finalize().iter().map(|b| format!("{b:02x}")).collect()
}

pub(super) fn shown_config(config: &ServiceConfig) -> ShownConfig {
    let digest = Sha256::digest(config.text.as_bytes());
    let hash = digest.iter().map(|b| format!("{b:02x}")).collect();
    ShownConfig { text: config.text.clone(), hash }
}
