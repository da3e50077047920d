//! Tables of where the lanes of a block of eight words come from, by which of them are of a type.

/// Index that stands for no lane: its highest bit makes vector instructions take zero or what was before.
pub const NONE: u8 = 0x80;

/// `LATEST[mask][i]`: the last lane of the mask at or before `i`.
pub static LATEST: [[u8; 8]; 256] = latest();

/// `KEPT[mask][i]`: the lane of the mask that has `i` others before it, or 0.
pub static KEPT: [[u8; 8]; 256] = kept();

const fn latest() -> [[u8; 8]; 256] {
    let mut table = [[NONE; 8]; 256];
    let mut mask = 0;
    while mask < table.len() {
        let (mut lane, mut last) = (0, NONE);
        while lane < 8 {
            if mask >> lane & 1 > 0 {
                last = lane as u8;
            }
            table[mask][lane] = last;
            lane += 1;
        }
        mask += 1;
    }
    table
}

const fn kept() -> [[u8; 8]; 256] {
    let mut table = [[0; 8]; 256];
    let mut mask = 0;
    while mask < table.len() {
        let (mut lane, mut count) = (0, 0);
        while lane < 8 {
            if mask >> lane & 1 > 0 {
                table[mask][count] = lane as u8;
                count += 1;
            }
            lane += 1;
        }
        mask += 1;
    }
    table
}

/// Returns a table of lanes of two bytes as one of bytes, each [`NONE`] as two.
pub const fn of_two_bytes(lanes: &[[u8; 8]; 256]) -> [[u8; 16]; 256] {
    let mut table = [[NONE; 16]; 256];
    let mut mask = 0;
    while mask < table.len() {
        let mut lane = 0;
        while lane < 8 {
            let from = lanes[mask][lane];
            if from != NONE {
                table[mask][2 * lane] = 2 * from;
                table[mask][2 * lane + 1] = 2 * from + 1;
            }
            lane += 1;
        }
        mask += 1;
    }
    table
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lanes_are_those_of_the_mask() {
        for mask in 0..=255_u8 {
            let lanes: Vec<u8> = (0..8).filter(|lane| mask >> lane & 1 > 0).collect();
            let kept = KEPT[usize::from(mask)];
            assert_eq!(&kept[..lanes.len()], lanes);
            for lane in 0..8 {
                let latest = lanes.iter().rfind(|other| **other <= lane);
                let found = LATEST[usize::from(mask)][usize::from(lane)];
                assert_eq!(found, *latest.unwrap_or(&NONE));
                let bytes = &of_two_bytes(&LATEST)[usize::from(mask)];
                let pair = &bytes[2 * usize::from(lane)..][..2];
                let wanted = latest.map_or([NONE; 2], |lane| [2 * lane, 2 * lane + 1]);
                assert_eq!(pair, wanted);
            }
        }
    }
}
