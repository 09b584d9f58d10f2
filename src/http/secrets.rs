//! Tokens in what people write: a secret that is pasted into a reason or a name must not reach the record.

use sha2::{Digest as _, Sha256};

/// How the text of every token begins.
pub(super) const PREFIX: &str = "stillcut_";
/// A secret is longer than the words around it: 256 bits are 43 characters, half of them give it away.
const SHORTEST_SECRET: usize = 20;
/// What stands where a token stood.
pub(super) const REDACTED: &str = "[a token was left out]";

fn is_of_a_token(c: char) -> bool {
    c.is_ascii_alphanumeric() || c == '-' || c == '_'
}

fn runs(text: &str) -> impl Iterator<Item = &str> {
    text.split(|c| !is_of_a_token(c)).filter(|run| run.len() >= SHORTEST_SECRET)
}

/// Whether a text holds something of the form of our tokens.
#[must_use]
pub fn holds_token(text: &str) -> bool {
    runs(text).any(|run| run.rfind(PREFIX).is_some_and(|at| run.len() - at - PREFIX.len() >= SHORTEST_SECRET))
}

/// Whether a text holds a token of one of these SHA-256, whatever its form.
pub(super) fn holds_token_of(text: &str, known: impl Fn(&[u8; 32]) -> bool) -> bool {
    runs(text).any(|run| known(&Sha256::digest(run.as_bytes()).into()))
}

/// The text without what has the form of a token.
#[must_use]
pub(super) fn without_tokens(text: &str) -> String {
    if !holds_token(text) {
        return text.to_owned();
    }
    let mut kept = String::with_capacity(text.len());
    for part in text.split_inclusive(|c| !is_of_a_token(c)) {
        match part.find(PREFIX).filter(|_| holds_token(part)) {
            Some(at) => {
                kept.push_str(part.get(..at).unwrap_or_default());
                kept.push_str(REDACTED);
                kept.extend(part.chars().last().filter(|c| !is_of_a_token(*c)));
            }
            None => kept.push_str(part),
        }
    }
    kept
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_token_is_found_wherever_it_stands_and_words_are_none() {
        let token = crate::http::new_token([7; 32]).0;
        for text in [token.clone(), format!("it is {token}."), format!("x{token}"), format!("a={token}&b")] {
            assert!(holds_token(&text), "{text}");
            let kept = without_tokens(&text);
            assert!(!kept.contains(&token[20..]) && kept.contains(REDACTED), "{kept}");
        }
        assert!(holds_token(&token[..40]), "half a token is a secret too");
        for text in ["", "stillcut_service restarted", "stillcut_samples_lost_total went up", "Größe 12"] {
            assert!(!holds_token(text) && without_tokens(text) == text, "{text}");
        }
        let other = "a-secret-of-another-form-0123456789";
        let digest: [u8; 32] = Sha256::digest(other.as_bytes()).into();
        assert!(holds_token_of(&format!("my token: {other}!"), |d| *d == digest));
        assert!(!holds_token_of("my token: none of yours, 0123456789-0123456789", |d| *d == digest));
    }
}
