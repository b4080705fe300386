//! Cells of space by their indices: a table of open addresses, for who sorts points into cubes.
//!
//! ```
//! use agv_core::sensors::cells::{CellTable, pack, unpack};
//!
//! let mut table = CellTable::default();
//! let key = pack([3, -4, 0]).ok_or("out of reach")?;
//! assert_eq!(table.get_or_insert(key, 7), 7);
//! assert_eq!(table.get_or_insert(key, 8), 7, "it is there already");
//! assert_eq!((table.get(key), unpack(key)), (Some(7), [3, -4, 0]));
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

/// Cells to either side of the origin that a packed index holds.
pub const REACH: i32 = 1 << 20;

/// Marks a free slot; packed indices use 63 bits.
const FREE: u64 = u64::MAX;

/// Three cell indices of 21 bits each; `None` out of reach.
#[inline]
pub fn pack(cell: [i32; 3]) -> Option<u64> {
    let within = cell.iter().all(|index| (-REACH..REACH).contains(index));
    within.then(|| pack_within(cell))
}

/// As [`pack`], of a cell that is known to be in reach.
#[inline]
pub fn pack_within([x, y, z]: [i32; 3]) -> u64 {
    let bits = |index: i32| u64::from(index.wrapping_add(REACH) as u32 & 0x1f_ffff);
    bits(x) << 42 | bits(y) << 21 | bits(z)
}

/// The cell of a key.
#[inline]
pub fn unpack(key: u64) -> [i32; 3] {
    [key >> 42, key >> 21, key].map(|bits| (bits & 0x1f_ffff) as i32 - REACH)
}

/// The cell below or at a coordinate in cells. The cast rounds towards zero, which is one too many below zero; `floor` itself
/// is a library call below SSE4.1.
#[inline]
pub fn floor(value: f64) -> i32 {
    let whole = value as i32;
    whole.saturating_sub(i32::from(f64::from(whole) > value))
}

#[derive(Debug, Clone, Copy)]
struct Slot {
    key: u64,
    value: u32,
}

/// A number for each cell that was entered, by the keys that [`pack`] gives; others below 2⁶³ do as well. A look-up is one cache
/// miss: key and number lie side by side. The order of the table reaches nobody: who needs an order keeps a list beside it.
#[derive(Debug, Clone, Default)]
pub struct CellTable {
    slots: Vec<Slot>,
    len: usize,
}

impl CellTable {
    /// Cells that were entered.
    pub const fn len(&self) -> usize {
        self.len
    }

    /// Whether no cell was entered.
    pub const fn is_empty(&self) -> bool {
        self.len == 0
    }

    /// Forgets all cells; the memory stays.
    pub fn clear(&mut self) {
        self.slots.fill(Slot { key: FREE, value: 0 });
        self.len = 0;
    }

    /// The number of a cell.
    #[inline]
    pub fn get(&self, key: u64) -> Option<u32> {
        if self.slots.is_empty() {
            return None;
        }
        let slot = self.slots[self.place(key)];
        (slot.key == key).then_some(slot.value)
    }

    /// The number of a cell, which is `value` for one that was not there.
    #[inline]
    pub fn get_or_insert(&mut self, key: u64, value: u32) -> u32 {
        if 2 * (self.len + 1) > self.slots.len() {
            self.grow();
        }
        let place = self.place(key);
        let slot = &mut self.slots[place];
        if slot.key == FREE {
            *slot = Slot { key, value };
            self.len += 1;
        }
        slot.value
    }

    /// The slot of the key, or the free one where it belongs. There are free slots: at most half are taken.
    #[inline]
    fn place(&self, key: u64) -> usize {
        let mask = self.slots.len() - 1;
        // Fibonacci hashing (Knuth, vol. 3, section 6.4). A bit of the key changes its own and higher bits of the product only, so
        // that the highest ones have to be taken: a power of two slots has as many bits as are left.
        let mut at = (key.wrapping_mul(0x9e37_79b9_7f4a_7c15) >> (self.slots.len().leading_zeros() + 1)) as usize;
        while self.slots[at].key != key && self.slots[at].key != FREE {
            at = (at + 1) & mask;
        }
        at
    }

    /// Doubles the table.
    #[cold]
    fn grow(&mut self) {
        let size = (2 * self.slots.len()).max(1 << 10);
        let before = std::mem::replace(&mut self.slots, vec![Slot { key: FREE, value: 0 }; size]);
        for slot in before.into_iter().filter(|slot| slot.key != FREE) {
            let place = self.place(slot.key);
            self.slots[place] = slot;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cells_keep_their_numbers_while_the_table_grows() {
        let mut table = CellTable::default();
        assert_eq!(table.get(pack_within([0, 0, 0])), None);
        let cells = (0..5000_i32).map(|i| [i % 37 - 18, i / 37 - 60, -i]);
        for (number, cell) in cells.clone().enumerate() {
            assert_eq!(table.get_or_insert(pack(cell).unwrap(), number as u32), number as u32);
        }
        for (number, cell) in cells.clone().enumerate() {
            assert_eq!(unpack(pack_within(cell)), cell);
            assert_eq!(table.get(pack_within(cell)), Some(number as u32));
            assert_eq!(table.get_or_insert(pack_within(cell), 7), number as u32);
        }
        table.clear();
        assert!(cells.into_iter().all(|cell| table.get(pack_within(cell)).is_none()));
    }

    /// Lines along each axis and a floor, a wall and a block: a few probes each, whatever the size of the table.
    #[test]
    fn look_ups_take_few_probes_along_every_axis() {
        let line = |axis: usize| (0..450).map(move |i| [0, 1, 2].map(|a| if a == axis { i - 225 } else { 0 }));
        let sheet = |turns: usize| {
            (0..10_000).map(move |i| {
                let mut cell = [i % 100 - 50, i / 100 - 50, 3];
                cell.rotate_right(turns);
                cell
            })
        };
        let block = (0..8000).map(|i| [i % 20, i / 20 % 20, i / 400]);
        let cases = (0..3).flat_map(|axis| [line(axis).collect::<Vec<_>>(), sheet(axis).collect()]);
        for cells in cases.chain([block.collect()]) {
            let mut table = CellTable::default();
            for (number, cell) in cells.iter().enumerate() {
                assert_eq!(table.get_or_insert(pack_within(*cell), number as u32), number as u32);
            }
            let probes = |cell: &[i32; 3]| {
                let (key, bits) = (pack_within(*cell), table.slots.len().trailing_zeros());
                let home = (key.wrapping_mul(0x9e37_79b9_7f4a_7c15) >> (64 - bits)) as usize;
                1 + (table.place(key) + table.slots.len() - home) % table.slots.len()
            };
            let mean = cells.iter().map(probes).sum::<usize>() as f64 / cells.len() as f64;
            assert!(mean < 3.0, "{mean} probes for {:?} to {:?}", cells.first(), cells.last());
        }
    }

    #[test]
    fn cells_out_of_reach_have_no_key_and_floors_are_floors() {
        assert!(pack([REACH - 1, -REACH, 0]).is_some());
        assert!(
            pack([REACH, 0, 0]).is_none() && pack([0, -REACH - 1, 0]).is_none() && pack([0, 0, i32::MAX]).is_none()
        );
        for value in [-1.0, -0.999, -1e-9, 0.0, 0.3, 1.0, 1.999, -7.5] {
            assert_eq!(floor(value), value.floor() as i32, "{value}");
        }
        assert_eq!((floor(1e300), floor(-1e300)), (i32::MAX, i32::MIN));
    }
}
