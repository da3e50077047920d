//! The store on disk: its bound, and what damage, kills, power cuts and full disks cost.

use std::collections::BTreeSet;
use std::fs::File;
use std::io::{BufRead as _, BufReader, Read as _, Write as _};
use std::os::unix::fs::FileExt as _;
use std::process::{Child, Command, Stdio};
use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};

use proptest::prelude::*;
use rand_xoshiro::Xoshiro256PlusPlus;
use rand_xoshiro::rand_core::SeedableRng as _;

use super::record::{HEAD, TAIL};
use super::*;

/// No thread syncs while a test runs.
const SETTINGS: Settings = Settings {
    bytes_max: 1 << 20,
    sync_ms: 3_600_000,
};

const LEAST: Settings = Settings {
    bytes_max: BYTES_LEAST,
    ..SETTINGS
};

fn kept(run: u64, number: u64, bytes: usize) -> Kept {
    let mut random = Xoshiro256PlusPlus::seed_from_u64(run ^ number << 20);
    let mut frame = vec![0; bytes];
    random.fill_bytes(&mut frame);
    Kept {
        stamp: Stamp {
            run,
            number,
            end_us: number.wrapping_mul(3),
            up_us: 0,
        },
        frame: frame.into(),
    }
}

fn files(folder: &Path) -> Vec<PathBuf> {
    let entries = fs::read_dir(folder).unwrap();
    let mut paths: Vec<PathBuf> = entries.map(|entry| entry.unwrap().path()).collect();
    paths.sort_unstable();
    paths
}

fn names(folder: &Path) -> Vec<String> {
    let name = |path: &PathBuf| path.file_name().unwrap().to_str().unwrap().to_owned();
    files(folder).iter().map(name).collect()
}

/// Bytes that the files of a folder take, in whole blocks.
fn on_disk_of(folder: &Path) -> u64 {
    let bytes = |path: &PathBuf| on_disk(path.metadata().unwrap().len());
    files(folder).iter().map(bytes).sum()
}

#[test]
fn the_oldest_goes_and_is_counted() {
    let folder = tempfile::tempdir().unwrap();
    let mut disk = Disk::open(folder.path(), LEAST).unwrap();
    for number in 0..1000 {
        disk.append(&kept(1, number, 976));
        assert!(disk.figures().bytes <= BYTES_LEAST);
    }
    let figures = disk.figures();
    assert_eq!(figures.frames + figures.let_go, 1000);
    assert!(figures.bytes > BYTES_LEAST * 7 / 8, "{figures:?}");
    assert_eq!(on_disk_of(folder.path()), figures.bytes);
    for number in 0..1000 {
        let want = (number >= figures.let_go).then(|| kept(1, number, 976));
        assert_eq!(disk.get(1, number), want, "{number}");
    }
    drop(disk);
    let mut disk = Disk::open(folder.path(), LEAST).unwrap();
    let again = disk.figures();
    assert_eq!((again.frames, again.damaged), (figures.frames, 0));
    assert_eq!(disk.get(1, 999), Some(kept(1, 999, 976)));
    let range = Range {
        from: figures.let_go,
        to: 1000,
    };
    assert_eq!(disk.held(2, 9), [(1, range)]);
    // A record as large as many segments takes the place of many; a larger one than all is not taken.
    disk.append(&kept(2, 0, 40_000));
    disk.append(&kept(2, 1, BYTES_LEAST as usize));
    let figures = disk.figures();
    assert!(figures.bytes <= BYTES_LEAST, "{figures:?}");
    assert_eq!(
        (figures.failures, on_disk_of(folder.path())),
        (1, figures.bytes)
    );
    assert_eq!(disk.get(2, 0), Some(kept(2, 0, 40_000)));
    // A smaller bound than before.
    drop(disk);
    let less = Settings {
        bytes_max: 2 * BYTES_LEAST,
        ..SETTINGS
    };
    let mut disk = Disk::open(folder.path(), less).unwrap();
    for number in 2..200 {
        disk.append(&kept(2, number, 976));
    }
    drop(disk);
    let disk = Disk::open(folder.path(), LEAST).unwrap();
    assert!(disk.figures().bytes <= BYTES_LEAST && disk.figures().let_go > 0);
    assert_eq!(on_disk_of(folder.path()), disk.figures().bytes);
}

/// Ten frames in a file, damaged in many ways: what each costs is counted, and everything else is there.
#[test]
fn damage_costs_the_frames_that_it_meets() {
    const BYTES: usize = HEAD + 100 + TAIL;
    let at = |index: usize| index * BYTES;
    type Damage<'a> = (&'a str, &'a dyn Fn(&mut Vec<u8>), &'a [u64]);
    let damages: [Damage<'_>; 11] = [
        ("the first bytes", &|bytes| bytes[0] ^= 1, &[0]),
        ("a length", &|bytes| bytes[at(3) + 5] ^= 0x80, &[3]),
        ("a number", &|bytes| bytes[at(3) + 16] ^= 1, &[3]),
        ("a frame", &|bytes| bytes[at(7) + HEAD + 9] ^= 4, &[7]),
        ("the last CRC", &|bytes| bytes[at(10) - 1] ^= 4, &[9]),
        (
            "two apart",
            &|bytes| {
                bytes[at(2) + 1] = 0;
                bytes[at(8) + 70] ^= 1;
            },
            &[2, 8],
        ),
        (
            "three in a row",
            &|bytes| bytes[at(4) + 90..at(6) + 10].fill(0),
            &[4, 5, 6],
        ),
        // Of what is cut off, only the record that was begun can be known.
        ("a cut", &|bytes| bytes.truncate(at(9) + 30), &[9]),
        ("zeros behind", &|bytes| bytes[at(9)..].fill(0), &[9]),
        (
            "a record twice",
            &|bytes| bytes.copy_within(at(6)..at(7), at(7)),
            &[7],
        ),
        (
            "all of it",
            &|bytes| bytes.fill(0x55),
            &[0, 1, 2, 3, 4, 5, 6, 7, 8, 9],
        ),
    ];
    for (what, damage, lost) in damages {
        let folder = tempfile::tempdir().unwrap();
        let mut disk = Disk::open(folder.path(), SETTINGS).unwrap();
        for number in 5..15 {
            disk.append(&kept(3, number, 100));
        }
        drop(disk);
        let path = &files(folder.path())[0];
        let mut bytes = fs::read(path).unwrap();
        assert_eq!(bytes.len(), at(10));
        damage(&mut bytes);
        fs::write(path, &bytes).unwrap();
        // Opening it again finds the same.
        for _ in 0..2 {
            let mut disk = Disk::open(folder.path(), SETTINGS).unwrap();
            let figures = disk.figures();
            // Without any ordinal it is at least one.
            let known = if lost.len() < 10 {
                lost.len() as u64
            } else {
                1
            };
            assert_eq!(figures.damaged, known, "{what}");
            assert_eq!(figures.frames, 10 - lost.len() as u64, "{what}");
            assert!(figures.damaged_bytes > 0, "{what}");
            assert_eq!((figures.let_go, figures.failures), (0, 0), "{what}");
            for number in 0..10 {
                let want = (!lost.contains(&number)).then(|| kept(3, number + 5, 100));
                assert_eq!(disk.get(3, number + 5), want, "{what}: {number}");
                let next = (number..10).find(|number| !lost.contains(number));
                assert_eq!(
                    disk.next_held(3, number + 5),
                    next.map(|next| next + 5),
                    "{what}"
                );
            }
            assert_eq!(
                names(folder.path()),
                ["00000000000000000003-00000000000000000000.damaged"]
            );
        }
        // Writing continues in another segment, and what is damaged goes when it is the oldest.
        let mut disk = Disk::open(folder.path(), LEAST).unwrap();
        disk.append(&kept(4, 0, 10));
        assert_eq!(disk.get(4, 0), Some(kept(4, 0, 10)));
        assert_eq!(files(folder.path()).len(), 2);
        for number in 1..100 {
            disk.append(&kept(4, number, 2000));
        }
        assert_eq!(disk.figures().damaged_bytes, 0, "{what}");
        assert!(
            names(folder.path())
                .iter()
                .all(|name| name.ends_with(".kept"))
        );
    }
}

#[test]
fn damage_in_use_is_found_when_it_is_read() {
    let folder = tempfile::tempdir().unwrap();
    let mut disk = Disk::open(folder.path(), SETTINGS).unwrap();
    for number in 0..3 {
        disk.append(&kept(1, number, 100));
    }
    let file = File::options()
        .write(true)
        .open(&files(folder.path())[0])
        .unwrap();
    file.write_all_at(&[0; 3], (HEAD + 100 + TAIL + HEAD) as u64)
        .unwrap();
    assert_eq!(disk.get(1, 1), None);
    let figures = disk.figures();
    assert_eq!(
        (figures.frames, figures.damaged, figures.damaged_bytes),
        (2, 1, 148)
    );
    assert_eq!(disk.next_held(1, 1), Some(2));
    // It is counted once, and what follows is written on.
    assert_eq!(disk.get(1, 1), None);
    disk.append(&kept(1, 3, 100));
    assert_eq!(disk.figures().damaged, 1);
    for number in [0, 2, 3] {
        assert_eq!(disk.get(1, number), Some(kept(1, number, 100)));
    }
    assert!(names(folder.path())[0].ends_with(".damaged"));
}

/// A file that is gone, one that cannot be a segment, and one that is all damaged between others.
#[test]
fn frames_of_files_that_are_gone_are_counted() {
    let folder = tempfile::tempdir().unwrap();
    let mut disk = Disk::open(folder.path(), LEAST).unwrap();
    for number in 0..20 {
        disk.append(&kept(1, number, 976));
    }
    drop(disk);
    let paths = files(folder.path());
    assert_eq!(paths.len(), 5);
    fs::remove_file(&paths[1]).unwrap();
    fs::write(&paths[2], [0; 5000]).unwrap();
    fs::write(&paths[3], []).unwrap();
    let disk = Disk::open(folder.path(), LEAST).unwrap();
    let figures = disk.figures();
    assert_eq!(
        (figures.frames, figures.damaged, figures.damaged_bytes),
        (8, 12, 5000)
    );
    assert_eq!(disk.next_held(1, 4), Some(16));
    // A file that is longer than any segment is not read to its end.
    let long = File::options().write(true).open(&paths[4]).unwrap();
    long.set_len(1 << 40).unwrap();
    let settings = Settings {
        bytes_max: 1 << 41,
        ..SETTINGS
    };
    let mut disk = Disk::open(folder.path(), settings).unwrap();
    assert_eq!(disk.figures().frames, 8);
    assert_eq!(disk.get(1, 19), Some(kept(1, 19, 976)));
}

#[test]
fn other_files_are_left_alone_and_an_earlier_format_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    for name in ["notes.txt", "x-1.kept", "5.kept", "5.frames"] {
        fs::write(folder.path().join(name), "something").unwrap();
    }
    fs::create_dir(folder.path().join("1-1.kept")).unwrap();
    let disk = Disk::open(folder.path(), SETTINGS).unwrap();
    assert_eq!(disk.figures(), Figures::default());
    assert_eq!(files(folder.path()).len(), 5);
    let too_small = Settings {
        bytes_max: 10,
        ..SETTINGS
    };
    assert!(Disk::open(folder.path(), too_small).is_err());
    let earlier = "00000000000000000001-00000000000000000000.frames";
    fs::write(folder.path().join(earlier), "something").unwrap();
    let said = Disk::open(folder.path(), SETTINGS).unwrap_err().to_string();
    assert!(
        said.contains(earlier) && said.contains("an earlier version"),
        "{said}"
    );
    assert_eq!(files(folder.path()).len(), 6);
}

#[test]
fn what_cannot_be_written_is_counted() {
    let folder = tempfile::tempdir().unwrap();
    let inside = folder.path().join("store");
    let mut disk = Disk::open(&inside, SETTINGS).unwrap();
    fs::remove_dir_all(&inside).unwrap();
    disk.append(&kept(1, 0, 10));
    let failed = Figures {
        failures: 1,
        ..Figures::default()
    };
    assert_eq!(disk.figures(), failed);
    fs::create_dir(&inside).unwrap();
    disk.append(&kept(1, 1, 10));
    assert_eq!(disk.get(1, 1), Some(kept(1, 1, 10)));
    // A number that does not follow.
    disk.append(&kept(1, 1, 10));
    disk.append(&kept(0, 5, 10));
    assert_eq!(disk.figures().failures, 3);
}

/// A disk that is full, fails to sync, or loses its power.
#[derive(Debug, Default)]
struct Faulty {
    /// Bytes that are left; each write beyond them writes as many as fit, and fails.
    room: AtomicU64,
    fails_to_write: AtomicBool,
    fails_to_sync: AtomicBool,
    /// Files that are open, and the most that were at once.
    open: AtomicU64,
    open_most: AtomicU64,
    created: AtomicU64,
    /// The path of each file, and how much of it is synced.
    synced: Mutex<Vec<(PathBuf, u64)>>,
}

#[derive(Debug)]
struct FaultyFile {
    of: Arc<Faulty>,
    index: usize,
    file: File,
    end: AtomicU64,
}

impl Faulty {
    fn with_room(bytes: u64) -> Arc<Self> {
        let faulty = Self::default();
        faulty.room.store(bytes, Ordering::Relaxed);
        Arc::new(faulty)
    }

    /// Cuts the power: of what was not synced, a part is lost, or zeros.
    fn cut_power(&self, random: &mut Xoshiro256PlusPlus) {
        for (path, synced) in self.synced.lock().unwrap().iter() {
            let Ok(file) = File::options().write(true).open(path) else {
                continue;
            };
            let end = file.metadata().unwrap().len();
            let stays = synced + random.next_u64() % (end - synced + 1);
            file.set_len(stays).unwrap();
            if random.next_u32().is_multiple_of(2) {
                file.set_len(end).unwrap();
            }
        }
    }
}

/// The medium is what files refer to.
#[derive(Debug)]
struct Faults(Arc<Faulty>);

impl Medium for Faults {
    fn create(&self, path: &Path) -> io::Result<Arc<dyn Writable>> {
        let file = File::options().write(true).create_new(true).open(path)?;
        let mut synced = self.0.synced.lock().unwrap();
        synced.push((path.to_owned(), 0));
        let open = self.0.open.fetch_add(1, Ordering::Relaxed) + 1;
        self.0.open_most.fetch_max(open, Ordering::Relaxed);
        self.0.created.fetch_add(1, Ordering::Relaxed);
        Ok(Arc::new(FaultyFile {
            of: Arc::clone(&self.0),
            index: synced.len() - 1,
            file,
            end: AtomicU64::new(0),
        }))
    }

    fn sync_folder(&self, _: &Path) -> io::Result<()> {
        Ok(())
    }
}

impl Writable for FaultyFile {
    fn write(&self, bytes: &[u8], place: u64) -> io::Result<()> {
        let room = self.of.room.load(Ordering::Relaxed);
        let fits = (bytes.len() as u64).min(room);
        self.file.write_all_at(&bytes[..fits as usize], place)?;
        self.of.room.fetch_sub(fits, Ordering::Relaxed);
        self.end.fetch_max(place + fits, Ordering::Relaxed);
        if self.of.fails_to_write.load(Ordering::Relaxed) {
            return Err(io::ErrorKind::Other.into());
        }
        match fits < bytes.len() as u64 {
            true => Err(StorageFull.into()),
            false => Ok(()),
        }
    }

    fn cut(&self, bytes: u64) -> io::Result<()> {
        let end = self.end.swap(bytes, Ordering::Relaxed);
        self.of.room.fetch_add(end - bytes, Ordering::Relaxed);
        self.file.set_len(bytes)
    }

    fn sync(&self) -> io::Result<()> {
        if self.of.fails_to_sync.load(Ordering::Relaxed) {
            return Err(io::ErrorKind::Other.into());
        }
        let end = self.end.load(Ordering::Relaxed);
        self.of.synced.lock().unwrap()[self.index].1 = end;
        Ok(())
    }
}

impl Drop for FaultyFile {
    fn drop(&mut self) {
        self.of.open.fetch_sub(1, Ordering::Relaxed);
    }
}

#[test]
fn a_full_disk_costs_the_frames_that_it_does_not_take() {
    const APPENDS: u64 = 100_000;
    let folder = tempfile::tempdir().unwrap();
    let faulty = Faulty::with_room(200_000);
    let medium = Arc::new(Faults(Arc::clone(&faulty)));
    let mut disk = Disk::open_on(folder.path(), SETTINGS, medium).unwrap();
    let mut held = Vec::new();
    for number in 0..APPENDS {
        let before = disk.figures();
        // Small ones fit for longer than large ones.
        disk.append(&kept(1, number, 10 + number as usize * 37 % 1500));
        let figures = disk.figures();
        if figures.frames > before.frames {
            held.push(number);
        }
        assert_eq!(figures.frames + figures.failures, number + 1);
    }
    let figures = disk.figures();
    assert!((150..1000).contains(&figures.frames), "{figures:?}");
    let created = faulty.created.load(Ordering::Relaxed);
    assert!(created <= 10, "{created} files");
    let open_most = faulty.open_most.load(Ordering::Relaxed);
    assert!(open_most <= 10, "{open_most} files open at once");
    assert_eq!(files(folder.path()).len() as u64, created);
    // There is room again.
    faulty.room.store(1 << 20, Ordering::Relaxed);
    for number in APPENDS..APPENDS + 100 {
        disk.append(&kept(1, number, 1000));
        held.push(number);
    }
    assert_eq!(disk.figures().failures, figures.failures);
    drop(disk);
    assert_eq!(faulty.open.load(Ordering::Relaxed), 0);
    let mut disk = Disk::open(folder.path(), SETTINGS).unwrap();
    assert_eq!(disk.figures().damaged, 0);
    assert_eq!(disk.figures().frames, held.len() as u64);
    for number in held {
        let bytes = match number < APPENDS {
            true => 10 + number as usize * 37 % 1500,
            false => 1000,
        };
        assert_eq!(disk.get(1, number), Some(kept(1, number, bytes)));
    }
}

/// A place that cannot be written is left behind; no file is left for each frame.
#[test]
fn a_disk_that_fails_costs_the_frames_that_it_does_not_take() {
    let folder = tempfile::tempdir().unwrap();
    let faulty = Faulty::with_room(1 << 30);
    let medium = Arc::new(Faults(Arc::clone(&faulty)));
    let mut disk = Disk::open_on(folder.path(), SETTINGS, medium).unwrap();
    for number in 0..300 {
        let fails = number % 100 >= 50;
        faulty.fails_to_write.store(fails, Ordering::Relaxed);
        disk.append(&kept(1, number, 100));
    }
    let figures = disk.figures();
    assert_eq!((figures.frames, figures.failures), (150, 150));
    assert_eq!(files(folder.path()).len(), 3);
    assert!(faulty.open_most.load(Ordering::Relaxed) <= 10);
    drop(disk);
    let mut disk = Disk::open(folder.path(), SETTINGS).unwrap();
    assert_eq!((disk.figures().frames, disk.figures().damaged), (150, 0));
    for number in 0..300 {
        let want = (number % 100 < 50).then(|| kept(1, number, 100));
        assert_eq!(disk.get(1, number), want);
    }
}

#[test]
fn a_power_cut_costs_what_was_not_synced() {
    let mut random = Xoshiro256PlusPlus::seed_from_u64(5);
    for _ in 0..50 {
        let folder = tempfile::tempdir().unwrap();
        let faulty = Faulty::with_room(1 << 30);
        let medium = Arc::new(Faults(Arc::clone(&faulty)));
        let mut disk = Disk::open_on(folder.path(), SETTINGS, medium).unwrap();
        // Some fill a segment between two syncs, of 64 KiB.
        let bytes = 100 + random.next_u32() as usize % 5000;
        let [synced, more] = [(); 2].map(|()| random.next_u64() % 30);
        for number in 0..synced {
            disk.append(&kept(1, number, bytes));
        }
        disk.sync();
        assert_eq!(disk.figures().unsynced, 0);
        for number in synced..synced + more {
            disk.append(&kept(1, number, bytes));
        }
        assert_eq!(disk.figures().unsynced, more);
        faulty.cut_power(&mut random);
        faulty.fails_to_sync.store(true, Ordering::Relaxed);
        drop(disk);
        let mut disk = Disk::open(folder.path(), SETTINGS).unwrap();
        for number in 0..synced + more {
            let got = disk.get(1, number);
            if number < synced || got.is_some() {
                assert_eq!(got, Some(kept(1, number, bytes)));
            }
        }
        let figures = disk.figures();
        assert!(
            figures.frames >= synced && figures.damaged <= more,
            "{figures:?}"
        );
    }
}

#[test]
fn what_is_not_synced_is_counted_and_the_next_is_kept_elsewhere() {
    let folder = tempfile::tempdir().unwrap();
    let faulty = Faulty::with_room(1 << 30);
    let medium = Arc::new(Faults(Arc::clone(&faulty)));
    let mut disk = Disk::open_on(folder.path(), SETTINGS, medium).unwrap();
    faulty.fails_to_sync.store(true, Ordering::Relaxed);
    disk.append(&kept(1, 0, 100));
    disk.append(&kept(1, 1, 100));
    disk.sync();
    let figures = disk.figures();
    assert_eq!(
        (figures.failures, figures.unsynced, figures.frames),
        (2, 0, 2)
    );
    faulty.fails_to_sync.store(false, Ordering::Relaxed);
    disk.append(&kept(1, 2, 100));
    disk.sync();
    assert_eq!((disk.figures().failures, disk.figures().unsynced), (2, 0));
    assert_eq!(files(folder.path()).len(), 2);
}

/// Without being asked: by the thread, or at once.
#[test]
fn what_is_written_is_synced() {
    for sync_ms in [0, 1] {
        let folder = tempfile::tempdir().unwrap();
        let faulty = Faulty::with_room(1 << 30);
        let medium = Arc::new(Faults(Arc::clone(&faulty)));
        let settings = Settings {
            sync_ms,
            ..SETTINGS
        };
        let mut disk = Disk::open_on(folder.path(), settings, medium).unwrap();
        for number in 0..5 {
            disk.append(&kept(1, number, 100));
            let mut waits = 0;
            while disk.figures().unsynced > 0 {
                waits += 1;
                assert!(sync_ms > 0 && waits < 60_000);
                std::thread::sleep(Duration::from_millis(1));
            }
            let synced: u64 = faulty
                .synced
                .lock()
                .unwrap()
                .iter()
                .map(|file| file.1)
                .sum();
            assert_eq!(synced, (number + 1) * 148);
        }
    }
}

/// Numbers and ordinals, with the ends of their range.
fn ends() -> impl Strategy<Value = u64> {
    prop_oneof![0..5u64, u64::MAX - 2..=u64::MAX, any::<u64>()]
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(100))]

    /// Files of any names with records of any fields, among other bytes: what is said to be there is there.
    #[test]
    fn any_folder_is_opened(
        files in prop::collection::vec(
            (ends(), ends(), any::<bool>(), prop::collection::vec(
                (ends(), ends(), 0..40usize, any::<u16>(), prop::collection::vec(any::<u8>(), 0..9)), 0..6)),
            0..5),
        run in ends(), number in ends(),
    ) {
        let folder = tempfile::tempdir().unwrap();
        for (run, ordinal, is_damaged, records) in files {
            let mut bytes = Vec::new();
            for (number, ordinal, frame_bytes, flip, rubbish) in records {
                let mut record = record::to_bytes(&kept(run, number, frame_bytes), ordinal).unwrap();
                // Most are undamaged.
                if let Some(byte) = record.get_mut(usize::from(flip) % 300) {
                    *byte ^= 1;
                }
                bytes.extend_from_slice(&record);
                bytes.extend_from_slice(&rubbish[..rubbish.len() / 5]);
            }
            let ending = if is_damaged { "damaged" } else { "kept" };
            fs::write(folder.path().join(format!("{run:020}-{ordinal:020}.{ending}")), bytes).unwrap();
        }
        let mut disk = Disk::open(folder.path(), SETTINGS).unwrap();
        let (before, ranges) = (disk.figures(), disk.held(run, usize::MAX));
        let mut found = 0;
        for of in ranges.iter().map(|(of, _)| *of).chain([run]).collect::<BTreeSet<u64>>() {
            let mut from = 0;
            while let Some(next) = disk.next_held(of, from) {
                let got = disk.get(of, next).map(|kept| kept.stamp.number);
                prop_assert_eq!(got, Some(next));
                found += 1;
                from = next + 1;
            }
        }
        // A number that is in two files is sent once.
        prop_assert!(found <= before.frames);
        disk.append(&kept(run, number, 10));
        let figures = disk.figures();
        prop_assert_eq!(figures.frames + figures.failures, before.frames + 1);
        prop_assert_eq!(figures.bytes, on_disk_of(folder.path()));
    }
}

/// Frames between two syncs of the process that is killed.
const BATCH: u64 = 8;

/// Bound of its store: frames of some runs fit.
const KILLED: Settings = Settings {
    bytes_max: 8 << 20,
    ..SETTINGS
};

fn killed_bytes(number: u64) -> usize {
    500 + (number * 7919 % 6000) as usize
}

/// Set for the process that is killed: its store's folder and its run.
const CHILD: &str = "EECVS_TEST_STORE";

/// Appends until it is killed, and says on stdout what is synced.
fn append_until_killed(said: &str) {
    let (run, folder) = said.split_once(' ').unwrap();
    let run = run.parse().unwrap();
    let mut disk = Disk::open(Path::new(folder), KILLED).unwrap();
    for number in 0.. {
        disk.append(&kept(run, number, killed_bytes(number)));
        if number % BATCH == BATCH - 1 {
            disk.sync();
            let figures = disk.figures();
            assert_eq!((figures.failures, figures.unsynced), (0, 0));
            println!("synced {}.", number + 1);
        }
    }
}

fn killed(run: u64, folder: &Path) -> Child {
    let mut command = Command::new(std::env::current_exe().unwrap());
    let test = "store::disk::tests::kills_and_damage_cost_no_other_frame";
    command
        .args(["--exact", test, "--nocapture"])
        .env(CHILD, format!("{run} {}", folder.display()))
        .stdout(Stdio::piped())
        .stderr(Stdio::null());
    command.spawn().unwrap()
}

/// A process that writes is killed many times, and then bytes of its files are flipped: frames that were synced and
/// are undamaged are there, and the others are counted.
///
/// Kills 20 times and flips 20 bytes; with `STRESS=50` in the environment, 1,000 times and 1,000 bytes, in some
/// minutes.
#[test]
fn kills_and_damage_cost_no_other_frame() {
    if let Ok(said) = std::env::var(CHILD) {
        return append_until_killed(&said);
    }
    let stress = std::env::var("STRESS").ok();
    let effort: u64 = stress.map_or(1, |stress| stress.parse().expect("STRESS is a number"));
    let mut random = Xoshiro256PlusPlus::seed_from_u64(11);
    let folder = tempfile::tempdir().unwrap();
    let mut cut = 0;
    for run in 1..=20 * effort {
        let mut child = killed(run, folder.path());
        let mut lines = BufReader::new(child.stdout.take().unwrap()).lines();
        let mut synced = 0;
        // At any moment of what it does after so many syncs: to open, to write, to sync, to delete.
        let after = random.next_u32() % 40;
        let mut acknowledged = |line: &str| {
            // A line that was cut has no end.
            let (_, said) = line.split_once("synced ")?;
            synced = said.strip_suffix('.')?.parse().ok()?;
            Some(())
        };
        for _ in 0..after {
            while acknowledged(&lines.next().unwrap().unwrap()).is_none() {}
        }
        for _ in 0..random.next_u32() % 200_000 {
            std::hint::spin_loop();
        }
        child.kill().unwrap();
        child.wait().unwrap();
        // What it said before it ended counts too.
        for line in lines {
            acknowledged(&line.unwrap());
        }
        let mut disk = Disk::open(folder.path(), KILLED).unwrap();
        let figures = disk.figures();
        assert!(figures.bytes <= KILLED.bytes_max);
        // A record that was begun, at the most.
        assert!(figures.damaged <= run, "{figures:?}");
        cut = cut.max(figures.damaged);
        let held = disk.held(0, usize::MAX);
        let of_run = held.iter().find(|(of, _)| *of == run);
        assert!(synced == 0 || of_run.is_some(), "{run}: {held:?}");
        for (of, range) in held {
            assert!(of != run || range.to >= synced, "{run}: {range:?} {synced}");
            for number in range.from..range.to {
                let want = kept(of, number, killed_bytes(number));
                assert_eq!(disk.get(of, number), Some(want), "{of} {number}");
            }
        }
        let on_disk = on_disk_of(folder.path());
        assert_eq!(on_disk, figures.bytes);
    }
    flip(folder.path(), 20 * effort, cut, &mut random);
}

/// Flips bytes of a store, and looks for every frame.
fn flip(folder: &Path, flips: u64, cut: u64, random: &mut Xoshiro256PlusPlus) {
    let disk = Disk::open(folder, KILLED).unwrap();
    let before = disk.figures();
    assert!(before.frames > 1000 && before.damaged <= cut, "{before:?}");
    // Each frame, and the bytes of its record: file, from, to.
    let mut frames = Vec::new();
    for (run, range) in disk.held(0, usize::MAX) {
        frames.extend((range.from..range.to).map(|number| (run, number)));
    }
    assert_eq!(frames.len() as u64, before.frames);
    drop(disk);
    let mut records = Vec::new();
    let mut bytes_of = Vec::new();
    for path in files(folder) {
        let mut bytes = Vec::new();
        File::open(&path).unwrap().read_to_end(&mut bytes).unwrap();
        let (run, _) = name_of(&path).unwrap();
        for part in record::Parts::new(&bytes, run) {
            if let record::Part::Record { place, head } = part {
                let frame = (run, head.stamp.number);
                records.push((frame, bytes_of.len(), place..place + head.record_bytes()));
            }
        }
        bytes_of.push((path, bytes));
    }
    assert_eq!(records.len(), frames.len());
    let mut damaged = BTreeSet::new();
    for _ in 0..flips {
        let file = random.next_u64() as usize % bytes_of.len();
        let bytes = &mut bytes_of[file].1;
        let place = random.next_u64() as usize % bytes.len();
        bytes[place] ^= 1 << (random.next_u32() % 8);
        let mut records = records.iter();
        let met = records.find(|(_, of, bytes)| *of == file && bytes.contains(&place));
        damaged.extend(met.map(|(frame, ..)| *frame));
    }
    for (path, bytes) in &bytes_of {
        let mut file = File::create(path).unwrap();
        file.write_all(bytes).unwrap();
    }
    let mut disk = Disk::open(folder, KILLED).unwrap();
    let figures = disk.figures();
    for (run, number) in frames {
        let want = kept(run, number, killed_bytes(number));
        match disk.get(run, number) {
            Some(got) => assert_eq!(got, want),
            None => assert!(damaged.contains(&(run, number)), "{run} {number}"),
        }
    }
    let lost = before.frames - figures.frames;
    // Flips of one bit may undo each other.
    assert!(
        lost <= damaged.len() as u64 && lost + 2 >= damaged.len() as u64,
        "{lost}"
    );
    // The last records of a run are known from nothing that follows: some of those may be counted as one.
    let counted = figures.damaged - before.damaged;
    assert!(
        counted <= lost + 1 && counted + 8 >= lost,
        "{counted} of {lost}"
    );
}
