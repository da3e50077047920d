//! Unpacks any chunk: it is refused or stays within its bound. Packs any rows: they come back, to the bit.

use eecvs_hdf5::{Layout, pack, unpack};

/// Largest chunk that is unpacked, in bytes.
const BYTES_MAX: usize = 1 << 20;

/// Compounds: with padding, packed, and as small as they can be.
const LAYOUTS: [[u32; 9]; 3] = [
    [16, 8, 8, 0, 2, 2, 2, 4, 2],
    [13, 0, 8, 8, 2, 10, 2, 12, 1],
    [4, 0, 1, 1, 1, 2, 1, 3, 1],
];

/// Runs one input.
pub fn run(data: &[u8]) {
    let Some((choice, data)) = data.split_first() else {
        return;
    };
    let values = LAYOUTS[usize::from(*choice) % LAYOUTS.len()];
    let effort = u32::from(choice / 16 % 4);
    let layout = Layout::from_values(&[&values[..], &[effort]].concat()).expect("a layout");
    if let Ok(rows) = unpack(data, &layout, BYTES_MAX) {
        assert!(rows.len() <= BYTES_MAX);
    }
    let rows = &data[..data.len() / layout.row_bytes() * layout.row_bytes()];
    // Times that mostly rise, so that there are events to be packed.
    let mut rising = rows.to_vec();
    let [time, bytes] = [values[1] as usize, values[2] as usize];
    let mut t = 0_u64;
    for row in rising.chunks_exact_mut(layout.row_bytes()) {
        t = t.wrapping_add(u64::from(row[time]));
        row[time..time + bytes].copy_from_slice(&t.to_le_bytes()[..bytes]);
    }
    // Enough rows for frames.
    for rows in [rows.to_vec(), rising.repeat(1 + 4096 / (1 + rows.len()))] {
        let packed = pack(&rows, &layout).expect("whole rows");
        assert!(packed.len() <= rows.len() + 10);
        let back = unpack(&packed, &layout, rows.len());
        assert!(back.as_deref() == Ok(&rows[..]), "the rows differ");
    }
}
