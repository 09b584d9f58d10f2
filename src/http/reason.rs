//! Why somebody does something, in their words: what every write asks for and the record keeps.

use super::problem::Problem;
use super::{Caller, Role, Site};
use crate::service::Origin;
use axum::http::StatusCode;
use serde::Deserialize;
use utoipa::ToSchema;

/// Longest reason, characters; as in the schema.
const LONGEST: usize = 500;

/// One sentence for the record, 1 to 500 printable characters.
#[derive(Debug, Deserialize, ToSchema)]
#[serde(transparent)]
#[schema(
    min_length = 1,
    max_length = 500,
    pattern = "^[^\\x00-\\x1f\\x7f-\\x9f\\u2028-\\u202e\\u2066-\\u2069]*\
               [^\\x00-\\x1f\\x7f-\\x9f\\u2028-\\u202e\\u2066-\\u2069\\s]\
               [^\\x00-\\x1f\\x7f-\\x9f\\u2028-\\u202e\\u2066-\\u2069]*$"
)]
pub(super) struct Reason(String);

/// The body of a write that needs nothing else.
#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub(super) struct ReasonBody {
    /// One sentence for the record.
    reason: Reason,
}

/// What ends a line, or has the text after it read in another order than it is written.
fn is_unprintable(c: char) -> bool {
    c.is_control() || matches!(c, '\u{2028}'..='\u{202e}' | '\u{2066}'..='\u{2069}')
}

impl Reason {
    /// What stands on record where somebody acts without a word.
    pub(super) fn none_given() -> Self {
        Self("no reason given".to_owned())
    }

    /// The caller and the reason, for events and the audit record.
    ///
    /// Errors: `reason_required` for an empty, endless or unprintable one; `secret_in_text` for one that
    /// holds a token, since the record is open to more people than the token.
    pub(super) fn origin(&self, caller: &Caller, site: &Site) -> Result<Origin, Problem> {
        let refused = |code, detail, expected| {
            Err(Problem::new(StatusCode::UNPROCESSABLE_ENTITY, code, detail).with_field("/reason", expected))
        };
        let reason = self.0.trim();
        let printable = self.0.chars().count() <= LONGEST && !self.0.chars().any(is_unprintable);
        if reason.is_empty() || !printable {
            let detail = "a reason of 1 to 500 printable characters is needed";
            return refused("reason_required", detail, "expected one sentence");
        }
        if site.access.is_in(reason) {
            let detail = "the reason holds an access token; nothing of it was kept: consider a new token";
            return refused("secret_in_text", detail, "expected a sentence without a token");
        }
        Ok(self.origin_unquestioned(caller))
    }

    /// The same without a question: for what is done whatever was said.
    pub(super) fn origin_unquestioned(&self, caller: &Caller) -> Origin {
        let role = caller.role.map_or("none", Role::word).to_owned();
        Origin { actor: caller.name.clone(), role, reason: self.0.trim().to_owned() }
    }
}

impl ReasonBody {
    /// The caller and the reason; see [`Reason::origin`].
    pub(super) fn origin(&self, caller: &Caller, site: &Site) -> Result<Origin, Problem> {
        self.reason.origin(caller, site)
    }
}
