//! Keys and certificates of a fleet: one authority, and the members that it has signed.
//!
//! Keys are elliptic, on P-256. A hub's certificate contains the hosts under which it is reached; a client's
//! certificate contains only its identity.

use std::fs::{self, File, TryLockError};
use std::io::ErrorKind;
use std::net::IpAddr;
use std::path::{Path, PathBuf};
use std::thread;
use std::time::{Duration, Instant, SystemTime};

use anyhow::{Context as _, Result, ensure};
use event_files::output::{sync_folder, write, write_private};
use event_types::stream::small_file::read_text;
use rcgen::{
    BasicConstraints, CertificateParams, DnType, ExtendedKeyUsagePurpose, IsCa, Issuer, KeyPair,
    KeyUsagePurpose,
};

use crate::access::{Access, Role};

/// The authority's private key, which no other machine needs.
const AUTHORITY_KEY: &str = "authority-key.pem";
/// The authority's certificate, which every member has.
const AUTHORITY: &str = "ca.pem";

/// Largest file of a key or a certificate, in bytes.
const PEM_BYTES_MAX: u64 = 1 << 20;

/// How long a process waits for others that make keys in the folder.
const PATIENCE: Duration = Duration::from_secs(10);

/// How far clocks of two machines may differ: certificates are valid from this long before their creation.
const CLOCKS: Duration = Duration::from_secs(24 * 3600);

/// A folder with an authority's key and the list of the members that it has signed.
#[derive(Debug)]
pub struct Authority {
    folder: PathBuf,
    /// Locked, so that no other process makes keys in the folder meanwhile.
    _lock: Option<File>,
}

/// Locks a folder for this process, after any other that makes keys in it; the lock ends when the file is closed.
fn locked(folder: &Path) -> Result<Option<File>> {
    let until = Instant::now() + PATIENCE;
    // The file is the folder itself, so that no other file is needed; Windows cannot open it.
    if cfg!(windows) {
        return Ok(None);
    }
    let file = File::open(folder)?;
    loop {
        match file.try_lock() {
            Ok(()) => return Ok(Some(file)),
            Err(TryLockError::Error(error)) if error.kind() == ErrorKind::Unsupported => {
                return Ok(Some(file));
            }
            Err(TryLockError::Error(error)) => return Err(error.into()),
            Err(TryLockError::WouldBlock) => ensure!(
                Instant::now() < until,
                "another process makes keys here: repeat the command when it has ended"
            ),
        }
        thread::sleep(Duration::from_millis(10));
    }
}

impl Authority {
    /// Opens the authority in a folder, or creates one whose certificate is valid for `days`.
    ///
    /// # Errors
    /// The folder cannot be written, or it has the authority's certificate without its key.
    pub fn open(folder: &Path, days: u32) -> Result<Self> {
        let at = || folder.display().to_string();
        fs::create_dir_all(folder).with_context(at)?;
        let authority = Self {
            folder: folder.to_owned(),
            _lock: locked(folder).with_context(at)?,
        };
        let [of_key, of_certificate] = [AUTHORITY_KEY, AUTHORITY].map(|name| folder.join(name));
        ensure!(
            of_key.exists() || !of_certificate.exists(),
            "{}: {AUTHORITY} is there without {AUTHORITY_KEY}: put that key back, or name another folder",
            folder.display()
        );
        if !of_certificate.exists() {
            let key = match of_key.exists() {
                // The creation was cut short, or the certificate was lost: another one of the same key and the same
                // name stands for the same authority.
                true => authority.key()?,
                false => {
                    let key = KeyPair::generate()?;
                    write_private(&of_key, key.serialize_pem())?;
                    key
                }
            };
            let mut params = params("authority", days)?;
            params.is_ca = IsCa::Ca(BasicConstraints::Constrained(0));
            params.key_usages = vec![KeyUsagePurpose::KeyCertSign, KeyUsagePurpose::CrlSign];
            let certificate = params.self_signed(&key)?;
            write(&of_certificate, certificate.pem())?;
        }
        Ok(authority)
    }

    fn read(&self, name: &str) -> Result<String> {
        Ok(read_text(&self.folder.join(name), PEM_BYTES_MAX)?)
    }

    fn key(&self) -> Result<KeyPair> {
        let pem = self.read(AUTHORITY_KEY)?;
        KeyPair::from_pem(&pem)
            .with_context(|| self.folder.join(AUTHORITY_KEY).display().to_string())
    }

    /// Makes keys and a certificate for a member, adds it to the list, and returns the folder with its keys. A hub
    /// is reached under `hosts`; a receiver may receive from the sensors `hears`.
    ///
    /// # Errors
    /// The folder cannot be written, or the member has keys already.
    pub fn sign(
        &self,
        role: &Role,
        hosts: &[String],
        hears: &[String],
        days: u32,
    ) -> Result<PathBuf> {
        let folder = self.folder.join(folder_of(role));
        ensure!(
            !folder.exists(),
            "{} already exists: remove it to make new keys",
            folder.display()
        );
        let authority = self.read(AUTHORITY)?;
        let authority_key = self.key()?;
        let issuer = Issuer::from_ca_cert_pem(&authority, authority_key)
            .with_context(|| self.folder.join(AUTHORITY).display().to_string())?;
        let key = KeyPair::generate()?;
        let mut params = params(&role.common_name(), days)?;
        params.key_usages = vec![KeyUsagePurpose::DigitalSignature];
        params.extended_key_usages = vec![ExtendedKeyUsagePurpose::ClientAuth];
        if let Role::Hub(_) = role {
            params
                .extended_key_usages
                .push(ExtendedKeyUsagePurpose::ServerAuth);
            for host in hosts {
                params.subject_alt_names.push(match host.parse::<IpAddr>() {
                    Ok(address) => rcgen::SanType::IpAddress(address),
                    Err(_) => rcgen::SanType::DnsName(host.as_str().try_into()?),
                });
            }
        }
        let certificate = params.signed_by(&key, &issuer)?;
        let mut access = Access::read(&self.folder)?;
        access.add(role, hears);
        let files = Files {
            key: key.serialize_pem(),
            certificate: certificate.pem(),
            authority,
        };
        self.put(&folder, &files, &access)
            .with_context(|| folder.display().to_string())?;
        Ok(folder)
    }

    /// Makes a member's folder, which appears under its name only when it is complete.
    ///
    /// The list is written first: a listed member without keys can do nothing, and gets its keys by the next attempt.
    fn put(&self, folder: &Path, files: &Files, access: &Access) -> Result<()> {
        let part = tempfile::Builder::new()
            .prefix(".")
            .suffix(".part")
            .tempdir_in(&self.folder)?;
        write_private(&part.path().join("key.pem"), &files.key)?;
        write(&part.path().join("cert.pem"), &files.certificate)?;
        write(&part.path().join(AUTHORITY), &files.authority)?;
        access.write(&self.folder)?;
        fs::rename(part.path(), folder)?;
        // It is no longer there to be removed.
        let _ = part.keep();
        Ok(sync_folder(&self.folder)?)
    }
}

/// The files of a member, as text.
struct Files {
    key: String,
    certificate: String,
    authority: String,
}

/// Returns a member's folder: `sensor-hall-1.left` for the sensor `hall-1/left`. Names contain no dots, so folders
/// are distinct.
fn folder_of(role: &Role) -> String {
    role.common_name().replace(':', "-").replace('/', ".")
}

fn params(common_name: &str, days: u32) -> Result<CertificateParams> {
    let mut params = CertificateParams::new(Vec::new())?;
    params
        .distinguished_name
        .push(DnType::CommonName, common_name);
    let now = SystemTime::now();
    params.not_before = (now - CLOCKS).into();
    params.not_after = (now + Duration::from_secs(u64::from(days) * 24 * 3600)).into();
    Ok(params)
}
