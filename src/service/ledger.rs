//! The looks at the turret decision of the last seconds, kept beside the black box: with the samples they
//! make
//! every decision repeatable.
//!
//! All memory is taken at the start. A page begins with the state of the decision; when it is full the oldest
//! page is written over.

use crate::avoidance::account::{Look, LookWriter, MOST_BYTES};
use std::collections::VecDeque;
use std::sync::Arc;

/// Bytes of one page: some four hundred looks.
const PAGE: usize = 16 * 1024;
/// Bytes a second that a machine writes whose every report changes, at a look a millisecond.
const BYTES_1_S: f64 = 64.0 * 1024.0;
/// Numbers of the decision's state that find room without asking for memory.
const STATE: usize = 512;

/// Looks from one state on.
#[derive(Debug, Clone, PartialEq, Default)]
pub(super) struct Page {
    /// State of the decision before the first look.
    pub(super) state: Vec<u64>,
    /// What [`LookWriter`] wrote.
    pub(super) looks: Vec<u8>,
    /// Time of the newest sample of the last look, s.
    newest_s: Option<f64>,
}

impl Page {
    fn fresh() -> Self {
        Self { state: Vec::with_capacity(STATE), looks: Vec::with_capacity(PAGE), newest_s: None }
    }
}

/// What is kept.
#[derive(Debug)]
pub(super) struct Ledger {
    pages: VecDeque<Arc<Page>>,
    spare: Vec<Arc<Page>>,
    writer: LookWriter,
}

impl Ledger {
    /// Room for about `seconds`.
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)]
    pub(super) fn new(seconds: f64) -> Self {
        let count = ((seconds * BYTES_1_S / PAGE as f64).ceil() as usize + 1).clamp(2, 1600);
        Self {
            pages: VecDeque::with_capacity(count),
            spare: (0..count).map(|_| Arc::new(Page::fresh())).collect(),
            writer: LookWriter::default(),
        }
    }

    /// Call before the decision: a page begins where the last is full, with the state that `keep` writes.
    pub(super) fn before(&mut self, keep: impl FnOnce(&mut Vec<u64>)) {
        // A page that is being written to disk is full too: what follows does not touch it.
        let goes_on = |p: &Arc<Page>| p.looks.len() + MOST_BYTES <= PAGE && Arc::strong_count(p) == 1;
        if self.pages.back().is_some_and(goes_on) {
            return;
        }
        let Some(next) = self.spare.pop().or_else(|| self.pages.pop_front()) else { return };
        let mut page = Arc::into_inner(next).unwrap_or_else(Page::fresh);
        page.state.clear();
        page.looks.clear();
        page.newest_s = None;
        keep(&mut page.state);
        self.writer.begin();
        self.pages.push_back(Arc::new(page));
    }

    /// Takes the look that was just made.
    pub(super) fn push(&mut self, look: &Look) {
        let Some(page) = self.pages.back_mut().and_then(Arc::get_mut) else { return };
        self.writer.write(look, &mut page.looks);
        page.newest_s = look.t_s.or(page.newest_s);
    }

    /// Forgets everything: what comes next has another clock.
    pub(super) fn clear(&mut self) {
        self.spare.extend(self.pages.drain(..));
    }

    /// Everything, oldest first; nothing is copied.
    pub(super) fn snapshot(&self) -> Vec<Arc<Page>> {
        self.pages.iter().cloned().collect()
    }
}

/// The pages with looks at samples from `first_s` on.
pub(super) fn pages_since(pages: &[Arc<Page>], first_s: f64) -> &[Arc<Page>] {
    let begin = pages.iter().position(|p| p.newest_s.is_some_and(|t| t >= first_s));
    begin.and_then(|i| pages.get(i..)).unwrap_or_default()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::avoidance::Situation;
    use crate::avoidance::account::read_looks;

    #[test]
    fn keeps_the_newest_in_the_memory_it_has() {
        let mut ledger = Ledger::new(2.0);
        let (room, mut states) = (ledger.spare.len(), 0_u64);
        let look = |k: u32| {
            let now_s = 1e-3 * f64::from(k);
            let situation = Situation { now_s, newest_sample_s: Some(now_s), ..Situation::default() };
            Look { t_s: Some(now_s), situation, ..Look::default() }
        };
        for k in 0..50_000 {
            ledger.before(|words| {
                words.push(states);
                states += 1;
            });
            ledger.push(&look(k));
        }
        let pages = ledger.snapshot();
        assert_eq!((pages.len(), ledger.pages.len() + ledger.spare.len()), (room, room));
        assert!(ledger.pages.iter().all(|p| p.looks.capacity() == PAGE && p.state.capacity() == STATE));
        let (first, last) = (&pages[0], &pages[room - 1]);
        assert_eq!(last.state[0], states - 1);
        assert_eq!(first.state[0], states - room as u64);
        let since = pages_since(&pages, 49.0);
        let looks: Vec<Look> = since.iter().flat_map(|p| read_looks(&p.looks).unwrap()).collect();
        assert_eq!(looks.last(), Some(&look(49_999)));
        assert!(looks[0].t_s.unwrap() <= 49.0 && looks.len() < 2000);
        // Neighbouring looks follow one another across the pages.
        assert!(looks.windows(2).all(|w| w[1].t_s > w[0].t_s));
        ledger.clear();
        assert!(ledger.snapshot().is_empty() && pages_since(&[], 0.0).is_empty());
    }
}
