//! Tokens in what people write: a secret that is pasted into a reason or a name must not reach the record.

use sha2::{Digest as _, Sha256};

/// How the text of every token begins.
pub(super) const PREFIX: &str = "stillcut_";
/// 256 random bits are 43 characters of base64url.
const SECRET: usize = 43;
/// What stands where a token stood.
pub(super) const REDACTED: &str = "[a token was left out]";

fn is_of_a_token(c: char) -> bool {
    c.is_ascii_alphanumeric() || c == '-' || c == '_'
}

fn runs(text: &str) -> impl Iterator<Item = &str> {
    text.split(|c| !is_of_a_token(c))
}

/// As many characters as a secret has, in cases that change as letters drawn at random do: digests keep to
/// one case, and the name of a recording (words, then a number of capitals) changes it once.
fn is_random(run: &str) -> bool {
    let letters: Vec<bool> =
        run.bytes().filter(u8::is_ascii_alphabetic).map(|b| b.is_ascii_uppercase()).collect();
    run.len() >= SECRET && letters.windows(2).filter(|pair| pair[0] != pair[1]).count() > 1
}

/// Half a secret behind the beginning of a token gives it away, too. The names of our metrics begin alike
/// and are words: 21 random characters without a capital, a digit or a dash come once in 10^8.
fn is_begun(run: &str) -> bool {
    let is_of_words = |b: u8| b.is_ascii_lowercase() || b == b'_';
    run.to_ascii_lowercase().rfind(PREFIX).is_some_and(|at| {
        let rest = &run.as_bytes()[at + PREFIX.len()..];
        rest.len() >= SECRET / 2 && !rest.iter().all(|b| is_of_words(*b))
    })
}

/// Whether a text holds something of the form of our tokens, whatever became of its beginning.
#[must_use]
pub fn holds_token(text: &str) -> bool {
    runs(text).any(|run| is_begun(run) || is_random(run))
}

/// Whether a text holds a token of one of these SHA-256: a word of it, two words that a blank parts, all of
/// it without its blanks, or letters in a row whatever stands between them, with or without its beginning.
pub(super) fn holds_token_of(text: &str, known: impl Fn(&[u8; 32]) -> bool) -> bool {
    let is_known = |word: &str| known(&Sha256::digest(word.as_bytes()).into());
    let bare = |word: &str| is_known(word) || is_known(word.trim_matches(|c| !is_of_a_token(c)));
    let words: Vec<&str> = text.split_whitespace().collect();
    let pairs = words.windows(2).any(|pair| bare(&pair.concat()));
    // Whatever stands between its characters, seen or not.
    let letters: String = text.chars().filter(|c| is_of_a_token(*c)).collect();
    let row = |at: usize| letters.get(at..at + SECRET).is_some_and(|row| is_known(&format!("{PREFIX}{row}")));
    let rows = (0..letters.len()).any(row);
    pairs || rows || words.iter().any(|word| bare(word)) || runs(text).any(is_known) || bare(&words.concat())
}

/// The text without what has the form of a token.
#[must_use]
pub(super) fn without_tokens(text: &str) -> String {
    let mut kept = String::with_capacity(text.len());
    for part in text.split_inclusive(|c| !is_of_a_token(c)) {
        if !holds_token(part) {
            kept.push_str(part);
            continue;
        }
        kept.push_str(part.get(..part.find(PREFIX).unwrap_or_default()).unwrap_or_default());
        kept.push_str(REDACTED);
        kept.extend(part.chars().last().filter(|c| !is_of_a_token(*c)));
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
        let core = &token[PREFIX.len()..];
        for text in
            [core.to_owned(), token[1..].to_owned(), token.to_uppercase()[..1].to_owned() + &token[1..]]
        {
            assert!(holds_token(&text) && !without_tokens(&text).contains(core), "{text}");
        }
        let hash = "9f86d081884c7d659a2feaa0c55ad015a3bf4f1b2b0b822cd15d6c15b0f00a08";
        assert!(
            !holds_token(hash) && !holds_token("the_name_of_a_recording_that_is_longer_than_a_secret_is")
        );
        for text in [
            "",
            "stillcut_service restarted",
            "stillcut_samples_lost_total went up",
            "Größe 12",
            "stillcut_force_usable_band_hertz shows 101 to 512",
            "chatter_not_suppressed-01JDNB6Q2ZK8V4W7X9Y0ABCDEF is the one",
        ] {
            assert!(!holds_token(text) && without_tokens(text) == text, "{text}");
        }
        let other = "a-secret-of-another-form-0123456789";
        let digest: [u8; 32] = Sha256::digest(other.as_bytes()).into();
        assert!(holds_token_of(&format!("my token: {other}!"), |d| *d == digest));
        let ours: [u8; 32] = Sha256::digest(token.as_bytes()).into();
        for at in [3, PREFIX.len(), 20, 40] {
            let parted = format!("it is {} {} today", &token[..at], &token[at..]);
            assert!(holds_token_of(&parted, |d| *d == ours), "{parted}");
        }
        for between in ["\u{200b}", "\u{ad}", ".", " / "] {
            let parted = format!("it is {}{between}{}", &token[..30], &token[30..]);
            assert!(holds_token_of(&parted, |d| *d == ours), "{parted:?}");
        }
        let thrice = format!("{} {} {}", &core[..9], &core[9..30], &core[30..]);
        assert!(holds_token_of(&thrice, |d| *d == ours));
        for (other, said) in
            [("Pass.word!", "it is Pass.word! today"), ("k-12", "(k-12)"), ("a+b/c=", "a+b /c=")]
        {
            let digest: [u8; 32] = Sha256::digest(other.as_bytes()).into();
            assert!(holds_token_of(said, |d| *d == digest), "{said}");
        }
        assert!(!holds_token_of("my token: none of yours, 0123456789-0123456789", |d| *d == digest));
    }
}
