//! Translates errors of libusb into link errors.

use rusb::Error;

use crate::link::LinkError;

/// Path of the udev rule. It must sort before 73-seat-late.rules, which gives the logged-in user access.
pub const RULES_FILE: &str = "/etc/udev/rules.d/65-event-cameras.rules";

/// Returns, in one line, how a user gets permission to open the device.
pub(super) fn remedy(vendor: u16, product: u16) -> String {
    format!(
        "put the line SUBSYSTEM==\"usb\", ATTR{{idVendor}}==\"{vendor:04x}\", \
         ATTR{{idProduct}}==\"{product:04x}\", TAG+=\"uaccess\" into {RULES_FILE}, run `sudo udevadm \
         control --reload && sudo udevadm trigger`, and connect the device again"
    )
}

/// Converts a libusb error into a link error; `step` names the step that failed.
pub(super) fn link_error(
    link: &str,
    (vendor, product): (u16, u16),
    step: &str,
    error: Error,
) -> LinkError {
    let link = link.to_owned();
    match error {
        // A removal appears as either of these, depending on what the kernel had noticed.
        Error::NoDevice | Error::Io => LinkError::Unplugged { link },
        Error::Access => LinkError::Permission {
            link,
            remedy: remedy(vendor, product),
        },
        Error::Busy => LinkError::Busy { link },
        Error::NoMem => LinkError::Failed {
            link,
            cause: format!(
                "{step}: the kernel does not have enough memory; see \
                 /sys/module/usbcore/parameters/usbfs_memory_mb"
            ),
        },
        Error::Pipe => LinkError::Failed {
            link,
            cause: format!("{step}: the device refused it"),
        },
        other => LinkError::Failed {
            link,
            cause: format!("{step}: {}", lower(&other.to_string())),
        },
    }
}

/// Lowercases the first letter, for use within a sentence.
fn lower(message: &str) -> String {
    let mut chars = message.chars();
    chars.next().map_or_else(String::new, |first| {
        first.to_lowercase().chain(chars).collect()
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_error_is_one_line_that_says_what_to_do() {
        let told = |error| link_error("usb 1-4", (0x152A, 0x841A), "open", error).to_string();
        assert_eq!(
            told(Error::Access),
            "usb 1-4: no permission to open it; put the line SUBSYSTEM==\"usb\", \
             ATTR{idVendor}==\"152a\", ATTR{idProduct}==\"841a\", TAG+=\"uaccess\" into \
             /etc/udev/rules.d/65-event-cameras.rules, run `sudo udevadm control --reload && sudo \
             udevadm trigger`, and connect the device again"
        );
        let gone = "usb 1-4: unplugged; connect it again and rerun the command";
        assert_eq!(told(Error::NoDevice), gone);
        assert_eq!(told(Error::Io), gone);
        assert!(told(Error::Busy).contains("in use by another program"));
        assert_eq!(told(Error::Timeout), "usb 1-4: open: operation timed out");
        for error in [Error::NoMem, Error::Pipe, Error::Other, Error::NotSupported] {
            let told = told(error);
            assert!(told.starts_with("usb 1-4: open: "), "{told}");
            assert!(!told.contains('\n'), "{told}");
        }
    }
}
