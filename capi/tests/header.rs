//! The header is that of the sources. `EECVS_BLESS=1 cargo test -p eecvs-capi --test header` writes it again.

use std::path::Path;

#[test]
fn the_header_is_that_of_the_sources() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR"));
    let config = cbindgen::Config::from_file(folder.join("cbindgen.toml")).expect("cbindgen.toml");
    let mut made = Vec::new();
    cbindgen::Builder::new()
        .with_crate(folder)
        .with_config(config)
        .generate()
        .expect("the sources have a header")
        .write(&mut made);
    let made = String::from_utf8(made).expect("text");
    let path = folder.join("include/eecvs.h");
    if std::env::var_os("EECVS_BLESS").is_some() {
        std::fs::write(&path, &made).expect("the header can be written");
    }
    let saved = std::fs::read_to_string(&path).unwrap_or_default();
    assert_eq!(saved, made, "{} is not that of the sources", path.display());
}
