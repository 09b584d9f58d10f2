//! What a black-box recording carries beside its samples, so that every decision can be made again: the
//! state of the pipeline before the first sample, what it decided, and digests of all that it said; and every
//! look at the decision on the turret, with all that was known and what was decided.

use crate::avoidance::account::Account;
use crate::keyframe::Digest;
use crate::sample::Recording;
use thiserror::Error;

/// Evidence of a live run over the samples of one recording.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Evidence {
    /// [`crate::pipeline::Pipeline::settings_digest`] of the live pipeline.
    pub settings: u64,
    /// State before the first sample.
    pub keyframe: Vec<u64>,
    /// Number of the first sample.
    pub first_sequence: u64,
    /// Samples and digest of what they led to, stretch after stretch.
    pub stretches: Vec<(usize, u64)>,
    /// `events.jsonl` of the live run over these samples.
    pub decisions: String,
    /// Looks at the decision on the turret.
    pub account: Option<Account>,
}

/// Why the evidence cannot be used.
#[derive(Debug, Clone, PartialEq, Eq, Error)]
pub enum EvidenceError {
    /// A piece is missing or not what was written.
    #[error("metadata {key} is missing or damaged")]
    Damaged {
        /// Metadata key.
        key: &'static str,
    },
}

const SETTINGS: &str = "pipeline_settings";
const KEYFRAME: &str = "keyframe";
const KEYFRAME_DIGEST: &str = "keyframe_digest";
const FIRST: &str = "first_sequence";
const STRETCHES: &str = "output_digests";
const DECISIONS: &str = "decisions";
const TURRET_SETTINGS: &str = "turret_settings";
const TURRET_STATE: &str = "turret_state";
const TURRET_LOOKS: &str = "turret_looks";
const TURRET_DIGEST: &str = "turret_digest";

fn digest_of(words: &[u64]) -> u64 {
    let mut digest = Digest::default();
    words.iter().for_each(|w| digest.word(*w));
    digest.value()
}

fn account_digest(account: &Account) -> u64 {
    let mut digest = Digest::default();
    account.state.iter().for_each(|w| digest.word(*w));
    for stretch in &account.stretches {
        digest.word(stretch.len() as u64);
        digest.bytes(stretch);
    }
    digest.value()
}

fn account_metadata(account: &Account) -> [(&'static str, String); 4] {
    let looks: Vec<String> = account.stretches.iter().map(|s| hex_of_bytes(s)).collect();
    [
        (TURRET_SETTINGS, format!("{:016x}", account.settings)),
        (TURRET_STATE, hex_of(&account.state)),
        (TURRET_LOOKS, looks.join(",")),
        (TURRET_DIGEST, format!("{:016x}", account_digest(account))),
    ]
}

fn account_of(recording: &Recording) -> Result<Option<Account>, EvidenceError> {
    let Some(looks) = recording.metadata(TURRET_LOOKS) else { return Ok(None) };
    let damaged = |key| EvidenceError::Damaged { key };
    let text = |key| recording.metadata(key).ok_or(EvidenceError::Damaged { key });
    let stretches = looks.split(',').filter(|s| !s.is_empty()).map(bytes_of);
    let account = Account {
        settings: word_of(text(TURRET_SETTINGS)?).ok_or(damaged(TURRET_SETTINGS))?,
        state: words_of(text(TURRET_STATE)?).ok_or(damaged(TURRET_STATE))?,
        stretches: stretches.collect::<Option<_>>().ok_or(damaged(TURRET_LOOKS))?,
    };
    if word_of(text(TURRET_DIGEST)?) != Some(account_digest(&account)) {
        return Err(damaged(TURRET_DIGEST));
    }
    Ok(Some(account))
}

impl Evidence {
    /// As metadata of the recording.
    #[must_use]
    pub fn metadata(&self) -> Vec<(String, String)> {
        let stretch = |(count, digest): &(usize, u64)| format!("{count}:{digest:016x}");
        let pairs = [
            (SETTINGS, format!("{:016x}", self.settings)),
            (KEYFRAME, hex_of(&self.keyframe)),
            (KEYFRAME_DIGEST, format!("{:016x}", digest_of(&self.keyframe))),
            (FIRST, self.first_sequence.to_string()),
            (STRETCHES, self.stretches.iter().map(stretch).collect::<Vec<_>>().join(",")),
            (DECISIONS, self.decisions.clone()),
        ];
        let account = self.account.iter().flat_map(account_metadata);
        pairs.into_iter().chain(account).map(|(key, value)| (key.to_owned(), value)).collect()
    }

    /// The evidence that a recording carries; nothing where it carries none. Errors: the damaged piece.
    pub fn of(recording: &Recording) -> Result<Option<Self>, EvidenceError> {
        if recording.metadata(KEYFRAME).is_none() {
            return Ok(None);
        }
        let damaged = |key| EvidenceError::Damaged { key };
        let text = |key| recording.metadata(key).ok_or(EvidenceError::Damaged { key });
        let keyframe = words_of(text(KEYFRAME)?).ok_or(damaged(KEYFRAME))?;
        if word_of(text(KEYFRAME_DIGEST)?) != Some(digest_of(&keyframe)) {
            return Err(damaged(KEYFRAME_DIGEST));
        }
        let stretch = |part: &str| {
            let (count, digest) = part.split_once(':')?;
            Some((count.parse().ok()?, word_of(digest)?))
        };
        let stretches: Option<Vec<_>> = text(STRETCHES)?.split(',').map(stretch).collect();
        Ok(Some(Self {
            settings: word_of(text(SETTINGS)?).ok_or(damaged(SETTINGS))?,
            first_sequence: text(FIRST)?.parse().map_err(|_| damaged(FIRST))?,
            stretches: stretches.ok_or(damaged(STRETCHES))?,
            decisions: text(DECISIONS)?.to_owned(),
            account: account_of(recording)?,
            keyframe,
        }))
    }
}

fn hex_of(words: &[u64]) -> String {
    use std::fmt::Write as _;
    let mut text = String::with_capacity(16 * words.len());
    for word in words {
        let _ = write!(text, "{word:016x}"); // a string takes everything
    }
    text
}

fn hex_of_bytes(bytes: &[u8]) -> String {
    const DIGITS: &[u8; 16] = b"0123456789abcdef";
    let digit = |half: u8| char::from(DIGITS[usize::from(half & 0xf)]);
    bytes.iter().flat_map(|byte| [digit(byte >> 4), digit(*byte)]).collect()
}

fn bytes_of(text: &str) -> Option<Vec<u8>> {
    if !text.len().is_multiple_of(2) || !text.is_ascii() {
        return None;
    }
    (0..text.len() / 2).map(|i| u8::from_str_radix(&text[2 * i..2 * i + 2], 16).ok()).collect()
}

fn word_of(text: &str) -> Option<u64> {
    u64::from_str_radix(text, 16).ok()
}

fn words_of(text: &str) -> Option<Vec<u64>> {
    if !text.len().is_multiple_of(16) || !text.is_ascii() {
        return None;
    }
    (0..text.len() / 16).map(|i| word_of(&text[16 * i..16 * i + 16])).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sample::Column;
    use crate::units::SampleRate;

    #[test]
    fn evidence_survives_the_metadata_and_damage_is_named() {
        let evidence = Evidence {
            settings: 7,
            keyframe: vec![0, u64::MAX, 1 << 63],
            first_sequence: 12,
            stretches: vec![(2250, 5), (3, u64::MAX)],
            decisions: "{\"t_s\":1.0}\n".into(),
            account: Some(Account {
                settings: 3,
                state: vec![9, 1 << 40],
                stretches: vec![vec![0, 255], vec![7]],
            }),
        };
        let mut recording = Recording {
            sample_rate: SampleRate::new(9000.0).unwrap(),
            experiment: String::new(),
            axes: vec![],
            columns: vec![Column { name: "a".into(), values: vec![0.0] }],
            start_s: 0.0,
            metadata: evidence.metadata(),
        };
        assert_eq!(Evidence::of(&recording), Ok(Some(evidence)));
        for place in 0..recording.metadata.len() {
            let mut bad = recording.clone();
            bad.metadata[place].1.insert(0, 'ü');
            let changed = bad.metadata[place].0 == DECISIONS;
            assert!(Evidence::of(&bad).is_err() || changed, "{}", bad.metadata[place].0);
        }
        recording.metadata.clear();
        assert_eq!(Evidence::of(&recording), Ok(None));
    }
}
