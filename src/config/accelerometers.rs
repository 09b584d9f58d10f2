//! The accelerometer estimator as a JSON file.

use super::ConfigError;
use crate::force::frf::{FrfEstimator, NODE_UNKNOWNS};
use rustfft::num_complex::Complex64;
use serde::{Deserialize, Serialize};
use std::path::Path;

const SCHEMA: &str = "stillcut.accelerometer_estimator/1";

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct FileDto {
    schema: String,
    estimators: Vec<EstimatorDto>,
}

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct EstimatorDto {
    axis: String,
    speed_range_rpm: [f64; 2],
    noise_floor_n: f64,
    condition: f64,
    nodes_hz: Vec<f64>,
    /// At each node: H, G, N of x, of y, of z, in N/m, real and imaginary part.
    values_n_m: Vec<Vec<[f64; 2]>>,
}

/// The file of some estimators, as text.
#[must_use]
pub fn estimators_to_text(estimators: &[FrfEstimator]) -> String {
    let estimators = estimators
        .iter()
        .map(|e| EstimatorDto {
            axis: e.axis.clone(),
            speed_range_rpm: e.speed_range_rpm,
            noise_floor_n: e.noise_floor_n,
            condition: e.condition,
            nodes_hz: e.nodes_hz.clone(),
            values_n_m: e.values.iter().map(|v| v.iter().map(|c| [c.re, c.im]).collect()).collect(),
        })
        .collect();
    let file = FileDto { schema: SCHEMA.to_owned(), estimators };
    // Names and numbers always have a text; a number that is not finite becomes null, which the reader
    // refuses.
    serde_json::to_string(&file).unwrap_or_default()
}

/// Reads estimators. Errors: unreadable, another format, functions that do not fit their nodes.
pub fn read_estimators(path: &Path) -> Result<Vec<FrfEstimator>, ConfigError> {
    let content = |place: &str, message: String| ConfigError::Content {
        path: path.to_owned(),
        place: place.to_owned(),
        message,
    };
    let text = super::read_text(path, "accelerometer estimator")?;
    let file: FileDto = serde_json::from_str(&text).map_err(|e| ConfigError::Syntax {
        path: path.to_owned(),
        line: e.line(),
        column: e.column(),
        message: e.to_string(),
    })?;
    if file.schema != SCHEMA {
        return Err(content("schema", format!("`{}`, expected `{SCHEMA}`", file.schema)));
    }
    let mut estimators = Vec::new();
    for dto in file.estimators {
        let mut values = Vec::with_capacity(dto.values_n_m.len());
        for node in &dto.values_n_m {
            let mut unknowns = [Complex64::new(0.0, 0.0); NODE_UNKNOWNS];
            if node.len() != NODE_UNKNOWNS {
                let message = format!("a node has {} values, expected {NODE_UNKNOWNS}", node.len());
                return Err(content("values_n_m", message));
            }
            for (u, [re, im]) in unknowns.iter_mut().zip(node) {
                *u = Complex64::new(*re, *im);
            }
            values.push(unknowns);
        }
        let estimator = FrfEstimator {
            axis: dto.axis,
            nodes_hz: dto.nodes_hz,
            values,
            speed_range_rpm: dto.speed_range_rpm,
            noise_floor_n: dto.noise_floor_n,
            condition: dto.condition,
        };
        estimator.check().map_err(|e| content(&format!("estimator of {}", estimator.axis), e.to_string()))?;
        estimators.push(estimator);
    }
    if estimators.is_empty() {
        return Err(content("estimators", "none in the file".to_owned()));
    }
    Ok(estimators)
}
