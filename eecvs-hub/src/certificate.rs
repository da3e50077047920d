//! Keys and certificates of a fleet: one authority, and the members that it has signed.
//!
//! Keys are elliptic, on P-256. A hub's certificate contains the hosts under which it is reached; a client's
//! certificate contains only its identity.

use std::fs::{self, OpenOptions};
use std::io::Write as _;
use std::net::IpAddr;
use std::path::{Path, PathBuf};
use std::time::{Duration, SystemTime};

use anyhow::{Context as _, Result, ensure};
use rcgen::{
    BasicConstraints, CertificateParams, DnType, ExtendedKeyUsagePurpose, IsCa, Issuer, KeyPair,
    KeyUsagePurpose,
};

use crate::access::{Access, Role};

/// The authority's private key, which no other machine needs.
const AUTHORITY_KEY: &str = "authority-key.pem";
/// The authority's certificate, which every member has.
const AUTHORITY: &str = "ca.pem";

/// How far clocks of two machines may differ: certificates are valid from this long before their creation.
const CLOCKS: Duration = Duration::from_secs(24 * 3600);

/// A folder with an authority's key and the list of the members that it has signed.
#[derive(Debug, Clone)]
pub struct Authority {
    folder: PathBuf,
}

impl Authority {
    /// Opens the authority in a folder, or creates one whose certificate is valid for `days`.
    ///
    /// # Errors
    /// The folder cannot be written, or it has the authority's key or certificate without the other.
    pub fn open(folder: &Path, days: u32) -> Result<Self> {
        let authority = Self {
            folder: folder.to_owned(),
        };
        let there = [AUTHORITY_KEY, AUTHORITY].map(|name| folder.join(name).exists());
        ensure!(
            there[0] == there[1],
            "{}: {AUTHORITY_KEY} and {AUTHORITY} belong together, but one of them is missing",
            folder.display()
        );
        if !there[0] {
            fs::create_dir_all(folder).with_context(|| folder.display().to_string())?;
            let key = KeyPair::generate()?;
            let mut params = params("authority", days)?;
            params.is_ca = IsCa::Ca(BasicConstraints::Constrained(0));
            params.key_usages = vec![KeyUsagePurpose::KeyCertSign, KeyUsagePurpose::CrlSign];
            let certificate = params.self_signed(&key)?;
            write_secret(&folder.join(AUTHORITY_KEY), &key.serialize_pem())?;
            write(&folder.join(AUTHORITY), &certificate.pem())?;
        }
        Ok(authority)
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
        let read = |name: &str| {
            let path = self.folder.join(name);
            fs::read_to_string(&path).with_context(|| path.display().to_string())
        };
        let authority = read(AUTHORITY)?;
        let authority_key = KeyPair::from_pem(&read(AUTHORITY_KEY)?)
            .with_context(|| self.folder.join(AUTHORITY_KEY).display().to_string())?;
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
        fs::create_dir_all(&folder).with_context(|| folder.display().to_string())?;
        write_secret(&folder.join("key.pem"), &key.serialize_pem())?;
        write(&folder.join("cert.pem"), &certificate.pem())?;
        write(&folder.join(AUTHORITY), &authority)?;
        access.write(&self.folder)?;
        Ok(folder)
    }
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

fn write(path: &Path, text: &str) -> Result<()> {
    fs::write(path, text).with_context(|| path.display().to_string())
}

/// Writes a new file that only its owner may read.
fn write_secret(path: &Path, text: &str) -> Result<()> {
    let mut options = OpenOptions::new();
    options.write(true).create_new(true);
    #[cfg(unix)]
    std::os::unix::fs::OpenOptionsExt::mode(&mut options, 0o600);
    let mut file = options
        .open(path)
        .with_context(|| path.display().to_string())?;
    file.write_all(text.as_bytes())
        .with_context(|| path.display().to_string())
}
