//! h5py writes and reads files through the filter, which HDF5's library finds by `HDF5_PLUGIN_PATH`. The variable
//! `EECVS_H5PY` names a Python that has h5py; the test is skipped, with a notice, without it and where `python3` has none.

use std::path::Path;
use std::process::Command;

/// What the script says where there is no h5py.
const SKIPPED: i32 = 77;

#[test]
fn h5py_writes_and_reads_files_through_the_filter() {
    let test = std::env::current_exe().unwrap();
    let built = test.parent().unwrap().join(format!(
        "{}eecvs_hdf5_plugin{}",
        std::env::consts::DLL_PREFIX,
        std::env::consts::DLL_SUFFIX
    ));
    // A folder of its own: HDF5's library opens everything in it.
    let folder = tempfile::tempdir().unwrap();
    let plugins = folder.path().join("plugins");
    std::fs::create_dir(&plugins).unwrap();
    std::fs::copy(&built, plugins.join(built.file_name().unwrap())).unwrap();

    let named = std::env::var_os("EECVS_H5PY");
    let python = named.clone().unwrap_or_else(|| "python3".into());
    let run = Command::new(&python)
        .arg(Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/h5py_files.py"))
        .arg(folder.path())
        .env("HDF5_PLUGIN_PATH", &plugins)
        .output();
    let run = match run {
        Err(error) if named.is_none() => {
            eprintln!("skipped: {}: {error}", python.display());
            return;
        }
        run => run.expect("the Python that EECVS_H5PY names"),
    };
    let out = String::from_utf8_lossy(&run.stdout);
    print!("{out}{}", String::from_utf8_lossy(&run.stderr));
    if run.status.code() == Some(SKIPPED) && named.is_none() {
        eprintln!("skipped: this Python has no h5py");
        return;
    }
    assert!(run.status.success(), "{}", run.status);
    assert_eq!(
        out.lines().filter(|line| line.starts_with("ok ")).count(),
        13
    );

    // Without HDF5's library and the plugin, by the readers of every command; but for times that fall back, whose order
    // is not theirs.
    for entry in std::fs::read_dir(folder.path()).unwrap() {
        let path = entry.unwrap().path();
        if path.extension().is_none_or(|ending| ending != "h5")
            || path.ends_with("table.h5")
            || path.ends_with("damaged.h5")
        {
            continue;
        }
        let mut reader = event_files::open(&path, None).unwrap();
        let mut events = Vec::new();
        while reader.read(&mut events).unwrap() > 0 {}
        assert_eq!(events.len(), 200_000, "{}", path.display());
        assert!(events.is_sorted_by_key(|event| event.t_us));
    }
}
