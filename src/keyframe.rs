//! Keyframes: the state of a pipeline as plain numbers, so that a replay can start in the middle.
//!
//! A state writes its fields in order and takes them back in place: a state that was made by the same
//! design has the same shape, so nothing but numbers needs to travel. The pattern in [`keep!`] names every
//! field: a field that is added later and forgotten here does not compile.

use rustfft::num_complex::Complex;

/// Numbers of a keyframe that are still to be read.
#[derive(Debug, Clone)]
pub struct Words<'a>(std::slice::Iter<'a, u64>);

impl<'a> Words<'a> {
    /// From the first.
    #[must_use]
    pub fn new(words: &'a [u64]) -> Self {
        Self(words.iter())
    }

    /// The next one; nothing at the end.
    pub fn next_word(&mut self) -> Option<u64> {
        self.0.next().copied()
    }

    /// Whether all were read.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.0.len() == 0
    }
}

/// A state that can be written to a keyframe and taken back from one.
pub trait Keep {
    /// Appends its numbers.
    fn keep(&self, to: &mut Vec<u64>);

    /// Takes its numbers back into a state of the same design. Nothing: too few, or one that cannot be.
    fn restore(&mut self, from: &mut Words<'_>) -> Option<()>;
}

impl Keep for f64 {
    fn keep(&self, to: &mut Vec<u64>) {
        to.push(self.to_bits());
    }

    fn restore(&mut self, from: &mut Words<'_>) -> Option<()> {
        *self = f64::from_bits(from.next_word()?);
        Some(())
    }
}

impl Keep for bool {
    fn keep(&self, to: &mut Vec<u64>) {
        to.push(u64::from(*self));
    }

    fn restore(&mut self, from: &mut Words<'_>) -> Option<()> {
        *self = match from.next_word()? {
            0 => false,
            1 => true,
            _ => return None,
        };
        Some(())
    }
}

/// Integers of a state count: one in the upper half of its range, which no count reaches, is refused, because
/// what counts on from there would overflow. Numbers that come from outside travel as plain words.
macro_rules! keep_counts {
    ($($kind:ty),*) => {$(
        impl Keep for $kind {
            fn keep(&self, to: &mut Vec<u64>) {
                to.push(*self as u64);
            }

            fn restore(&mut self, from: &mut Words<'_>) -> Option<()> {
                *self = <$kind>::try_from(from.next_word()?).ok().filter(|n| *n <= <$kind>::MAX / 2)?;
                Some(())
            }
        }
    )*};
}
keep_counts!(u16, u32, u64, usize);

impl<T: Keep> Keep for Complex<T> {
    fn keep(&self, to: &mut Vec<u64>) {
        self.re.keep(to);
        self.im.keep(to);
    }

    fn restore(&mut self, from: &mut Words<'_>) -> Option<()> {
        self.re.restore(from)?;
        self.im.restore(from)
    }
}

impl<A: Keep, B: Keep> Keep for (A, B) {
    fn keep(&self, to: &mut Vec<u64>) {
        self.0.keep(to);
        self.1.keep(to);
    }

    fn restore(&mut self, from: &mut Words<'_>) -> Option<()> {
        self.0.restore(from)?;
        self.1.restore(from)
    }
}

impl<T: Keep> Keep for [T] {
    fn keep(&self, to: &mut Vec<u64>) {
        self.iter().for_each(|x| x.keep(to));
    }

    fn restore(&mut self, from: &mut Words<'_>) -> Option<()> {
        self.iter_mut().try_for_each(|x| x.restore(from))
    }
}

impl<T: Keep, const N: usize> Keep for [T; N] {
    fn keep(&self, to: &mut Vec<u64>) {
        self.as_slice().keep(to);
    }

    fn restore(&mut self, from: &mut Words<'_>) -> Option<()> {
        self.as_mut_slice().restore(from)
    }
}

/// A vector's length belongs to the design and does not travel.
impl<T: Keep> Keep for Vec<T> {
    fn keep(&self, to: &mut Vec<u64>) {
        self.as_slice().keep(to);
    }

    fn restore(&mut self, from: &mut Words<'_>) -> Option<()> {
        self.as_mut_slice().restore(from)
    }
}

/// Whether it is there travels; what comes into an empty place starts from the default.
impl<T: Keep + Default> Keep for Option<T> {
    fn keep(&self, to: &mut Vec<u64>) {
        self.is_some().keep(to);
        if let Some(value) = self {
            value.keep(to);
        }
    }

    fn restore(&mut self, from: &mut Words<'_>) -> Option<()> {
        let mut there = false;
        there.restore(from)?;
        *self = if there {
            let mut value = T::default();
            value.restore(from)?;
            Some(value)
        } else {
            None
        };
        Some(())
    }
}

/// `keep!(State { a, b, c })`: all fields in order. `keep!(State { a, head } if |s| s.head < 8)`: a keyframe
/// whose numbers break the condition is refused. `keep!(State<L> { a })`: of any size `L`.
macro_rules! keep {
    ($name:ident $(<$size:ident>)? { $($field:ident),* $(,)? } $(if $good:expr)?) => {
        impl$(<const $size: usize>)? $crate::keyframe::Keep for $name$(<$size>)? {
            fn keep(&self, to: &mut Vec<u64>) {
                let Self { $($field),* } = self;
                $($crate::keyframe::Keep::keep($field, to);)*
            }

            fn restore(&mut self, from: &mut $crate::keyframe::Words<'_>) -> Option<()> {
                let Self { $($field),* } = self;
                $($crate::keyframe::Keep::restore($field, from)?;)*
                $(
                    let good: fn(&Self) -> bool = $good;
                    if !good(self) {
                        return None;
                    }
                )?
                Some(())
            }
        }
    };
}
pub(crate) use keep;

/// `keep_list!(Mode { Observe, Advise, Act })`: a plain enumeration as one number; another number is refused.
/// With names, `{ Observe => "observe", ... }`, it has the list of them and each its name, too.
macro_rules! keep_list {
    ($name:ident { $($variant:ident => $text:literal),* $(,)? }) => {
        $crate::keyframe::keep_list!($name { $($variant),* });

        impl $name {
            /// All of them.
            pub const ALL: [Self; [$($text),*].len()] = [$(Self::$variant),*];

            /// Its name.
            #[must_use]
            pub fn name(self) -> &'static str {
                match self { $(Self::$variant => $text),* }
            }
        }
    };
    ($name:ident { $($variant:ident),* $(,)? }) => {
        impl $crate::keyframe::Keep for $name {
            fn keep(&self, to: &mut Vec<u64>) {
                to.push(match self { $(Self::$variant => Self::$variant as u64),* });
            }

            fn restore(&mut self, from: &mut $crate::keyframe::Words<'_>) -> Option<()> {
                let word = from.next_word()?;
                *self = [$(Self::$variant),*].into_iter().find(|v| *v as u64 == word)?;
                Some(())
            }
        }
    };
}
pub(crate) use keep_list;

/// Fowler-Noll-Vo hash (FNV-1a, 64 bit) over bytes: tells different contents apart, keeps no secret.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Digest(u64);

impl Default for Digest {
    fn default() -> Self {
        Self(0xcbf2_9ce4_8422_2325)
    }
}

impl Digest {
    /// Takes one number in, lowest byte first.
    #[inline]
    pub fn word(&mut self, word: u64) {
        self.bytes(&word.to_le_bytes());
    }

    /// Takes bytes in.
    #[inline]
    pub fn bytes(&mut self, bytes: &[u8]) {
        for byte in bytes {
            self.0 = (self.0 ^ u64::from(*byte)).wrapping_mul(0x0000_0100_0000_01b3);
        }
    }

    /// What came out.
    #[must_use]
    pub fn value(self) -> u64 {
        self.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[derive(Debug, PartialEq, Clone)]
    struct State {
        value: f64,
        head: usize,
        seen: Option<f64>,
        many: Vec<Complex<f64>>,
    }
    keep!(State { value, head, seen, many } if |s| s.head < 8);

    #[test]
    fn a_state_comes_back_bit_for_bit_and_nonsense_is_refused() {
        let kept = State {
            value: -0.0,
            head: 7,
            seen: Some(f64::from_bits(1)),
            many: vec![Complex::new(1.5, f64::NEG_INFINITY); 3],
        };
        let mut words = Vec::new();
        kept.keep(&mut words);
        let fresh = State { value: 1.0, head: 0, seen: None, many: vec![Complex::new(0.0, 0.0); 3] };
        let mut back = fresh.clone();
        let mut from = Words::new(&words);
        back.restore(&mut from).unwrap();
        assert!(from.is_empty() && back == kept && back.value.to_bits() == kept.value.to_bits());
        for place in 0..words.len() {
            assert!(fresh.clone().restore(&mut Words::new(&words[..place])).is_none(), "cut at {place}");
        }
        words[1] = 8;
        assert!(fresh.clone().restore(&mut Words::new(&words)).is_none(), "head out of range");
        (words[1], words[2]) = (7, 2);
        assert!(fresh.clone().restore(&mut Words::new(&words)).is_none(), "neither there nor not");
    }

    #[test]
    fn the_digest_is_the_published_one() {
        // http://www.isthe.com/chongo/tech/comp/fnv/: FNV-1a 64 of "a" and "foobar".
        for (text, expected) in [("a", 0xaf63_dc4c_8601_ec8c), ("foobar", 0x8594_4171_f739_67e8_u64)] {
            let mut digest = Digest::default();
            digest.bytes(text.as_bytes());
            assert_eq!(digest.value(), expected);
        }
    }
}
