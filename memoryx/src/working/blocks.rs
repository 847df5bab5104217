//! A list that grows at its end and is cut at its beginning. A copy shares the blocks, so that a change of the copy touches a few items
//! and not all of them: each is counted where it lies, which is in no cache.

use std::sync::Arc;

use imbl::Vector;

/// Most items of a block.
const BLOCK: usize = 16;

/// Items in order, in blocks that are never empty.
#[derive(Clone)]
pub(super) struct Blocks<T: Clone> {
    blocks: Vector<Arc<[T]>>,
    len: usize,
}

impl<T: Clone> Default for Blocks<T> {
    fn default() -> Self {
        Self { blocks: Vector::new(), len: 0 }
    }
}

impl<T: Clone> Blocks<T> {
    pub(super) fn len(&self) -> usize {
        self.len
    }

    pub(super) fn first(&self) -> Option<&T> {
        self.blocks.front()?.first()
    }

    pub(super) fn last(&self) -> Option<&T> {
        self.blocks.back()?.last()
    }

    pub(super) fn iter(&self) -> impl DoubleEndedIterator<Item = &T> {
        self.blocks.iter().flat_map(|block| block.iter())
    }

    pub(super) fn push(&mut self, item: T) {
        self.len += 1;
        match self.blocks.back_mut().filter(|last| last.len() < BLOCK) {
            Some(last) => *last = last.iter().cloned().chain([item]).collect(),
            None => self.blocks.push_back([item].into()),
        }
    }

    pub(super) fn take_first(&mut self) -> Option<T> {
        let first = self.blocks.pop_front()?;
        let (item, rest) = first.split_first()?;
        self.len -= 1;
        if !rest.is_empty() {
            self.blocks.push_front(rest.into());
        }
        Some(item.clone())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn it_is_a_queue_whose_copies_stay() {
        let mut queue = Blocks::default();
        let mut copies = Vec::new();
        for n in 0..100 {
            queue.push(n);
            if n >= 40 {
                assert_eq!(queue.take_first(), Some(n - 40));
            }
            copies.push((queue.clone(), n));
        }
        for (copy, n) in copies {
            let expected: Vec<i32> = ((n - 39).max(0)..=n).collect();
            assert_eq!(copy.iter().copied().collect::<Vec<_>>(), expected);
            assert_eq!(
                (copy.len(), copy.first(), copy.last()),
                (expected.len(), expected.first(), expected.last())
            );
        }
        while queue.take_first().is_some() {}
        assert_eq!((queue.len(), queue.first(), queue.last()), (0, None, None));
    }
}
