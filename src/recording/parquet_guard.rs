//! A Parquet file as the library may see it: headers that claim more than the file can hold are refused
//! before the library walks through them.
//!
//! Footer and page headers are structs of Thrift's compact protocol. The library (parquet 60.1) skips what it
//! does not know element by element, without asking whether the file goes on: a list of 2^31 elements in a
//! file of 500 bytes keeps it busy for minutes (found by `fuzz/run parquet`). Here every element costs at
//! least one byte of what there is.

use bytes::Bytes;
use parquet::errors::{ParquetError, Result};
use parquet::file::reader::{ChunkReader, Length};
use std::fs::File;
use std::io::{BufReader, Read, Seek as _, SeekFrom};

/// Length of the footer's metadata and the word `PAR1`: the last bytes of a file.
const TAIL: u64 = 8;
/// Structs, lists and maps inside one another.
const DEPTH: u8 = 16;

/// A file whose headers are looked at first.
pub(super) struct Guarded {
    file: File,
    length: u64,
}

impl Guarded {
    /// Errors: no access; a footer that claims more than there is.
    pub(super) fn new(file: File) -> Result<Self> {
        let length = file.metadata()?.len();
        let guarded = Self { file, length };
        let Some(tail_at) = length.checked_sub(TAIL) else { return Ok(guarded) };
        let mut tail = [0; TAIL as usize];
        guarded.from(tail_at)?.read_exact(&mut tail)?;
        let claimed = u64::from(u32::from_le_bytes([tail[0], tail[1], tail[2], tail[3]]));
        // A length that does not fit is refused by the library.
        if let Some(begin) = tail_at.checked_sub(claimed) {
            guarded.look_at(begin, claimed)?;
        }
        Ok(guarded)
    }

    fn from(&self, start: u64) -> Result<BufReader<File>> {
        let mut file = self.file.try_clone()?;
        file.seek(SeekFrom::Start(start))?;
        Ok(BufReader::new(file))
    }

    /// Walks through the struct that begins at `start`.
    fn look_at(&self, start: u64, room: u64) -> Result<()> {
        // A truth value in a struct costs no byte of its own: twice the room is always enough.
        let mut walk = Walk { from: self.from(start)?.take(room), left: room.saturating_mul(2) };
        let eof = || ParquetError::EOF(format!("the header at byte {start} claims more than there is"));
        walk.skip(STRUCT, DEPTH).ok_or_else(eof)
    }
}

impl Length for Guarded {
    fn len(&self) -> u64 {
        self.length
    }
}

impl ChunkReader for Guarded {
    type T = BufReader<File>;

    /// Sequential reading is of the file's tail or begins with a page header.
    fn get_read(&self, start: u64) -> Result<Self::T> {
        if start.saturating_add(TAIL) != self.length {
            self.look_at(start, self.length.saturating_sub(start))?;
        }
        self.from(start)
    }

    fn get_bytes(&self, start: u64, length: usize) -> Result<Bytes> {
        let end = start.saturating_add(length as u64);
        if end > self.length {
            return Err(ParquetError::EOF(format!("bytes up to {end} of a file of {}", self.length)));
        }
        let mut buffer = vec![0; length];
        self.from(start)?.read_exact(&mut buffer)?;
        Ok(buffer.into())
    }
}

const STRUCT: u8 = 12;

/// A walk through a struct; `None`: it goes on beyond what there is, or is none.
struct Walk<R> {
    from: R,
    left: u64,
}

impl<R: Read> Walk<R> {
    fn spend(&mut self, count: u64) -> Option<()> {
        self.left = self.left.checked_sub(count)?;
        Some(())
    }

    fn bytes(&mut self, count: u64) -> Option<()> {
        self.spend(count)?;
        let copied = std::io::copy(&mut self.from.by_ref().take(count), &mut std::io::sink());
        (copied.ok()? == count).then_some(())
    }

    fn byte(&mut self) -> Option<u8> {
        self.spend(1)?;
        let mut byte = [0];
        self.from.read_exact(&mut byte).ok()?;
        Some(byte[0])
    }

    fn varint(&mut self) -> Option<u64> {
        let mut value = 0;
        for shift in (0..64).step_by(7) {
            let byte = self.byte()?;
            value |= u64::from(byte & 0x7f) << shift;
            if byte < 0x80 {
                return Some(value);
            }
        }
        None
    }

    fn skip(&mut self, kind: u8, depth: u8) -> Option<()> {
        let below = depth.checked_sub(1)?;
        match kind {
            1 | 2 => self.spend(1),
            3 => self.byte().map(drop),
            4..=6 => self.varint().map(drop),
            7 => self.bytes(8),
            8 => self.varint().and_then(|count| self.bytes(count)),
            9 | 10 => {
                let head = self.byte()?;
                let count = if head >> 4 == 15 { self.varint()? } else { u64::from(head >> 4) };
                (0..count).try_for_each(|_| self.skip(head & 15, below))
            }
            11 => {
                let count = self.varint()?;
                let kinds = if count > 0 { self.byte()? } else { 0 };
                (0..count).try_for_each(|_| {
                    self.skip(kinds >> 4, below)?;
                    self.skip(kinds & 15, below)
                })
            }
            STRUCT => loop {
                let head = self.byte()?;
                match head & 15 {
                    0 => return Some(()),
                    // The field's number stands on its own where the step to it is large.
                    kind if head >> 4 == 0 => {
                        self.varint()?;
                        self.skip(kind, below)?;
                    }
                    kind => self.skip(kind, below)?,
                }
            },
            13 => self.bytes(16),
            _ => None,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn walk(bytes: &[u8]) -> Option<()> {
        Walk { from: bytes, left: 2 * bytes.len() as u64 }.skip(STRUCT, DEPTH)
    }

    #[test]
    fn a_struct_is_walked_to_its_end_and_not_beyond() {
        // Fields 1 (i32), 2 (binary), 3 (true), 4 (list of two doubles), 20 (map of bytes), 21 (struct).
        let mut whole = vec![0x15, 0x80, 0x01, 0x18, 2, b'a', b'b', 0x11, 0x19, 0x27];
        whole.extend([0; 16]);
        whole.extend([0x0b, 40, 1, 0x33, 7, 7, 0x1c, 0x15, 2, 0, 0]);
        assert_eq!(walk(&whole), Some(()));
        for cut in 0..whole.len() {
            assert_eq!(walk(&whole[..cut]), None, "{cut}");
        }
    }

    #[test]
    fn lists_of_more_than_there_is_end_at_once() {
        for element in [1, 2, 3, 5, 7, 8, 12, 13] {
            assert_eq!(walk(&[0x19, 0xf0 | element, 0xff, 0xff, 0xff, 0xff, 0x07, 0, 0, 0]), None);
        }
        let nested = [vec![0x19], [0xf9, 0xff, 0xff, 0xff, 0xff, 0x07].repeat(100)].concat();
        assert_eq!(walk(&nested), None);
    }
}
