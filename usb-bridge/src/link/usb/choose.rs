//! Selects one of several devices by name.

use crate::link::LinkError;

/// The names by which a device can be selected.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Candidate {
    /// Port on the bus: `usb:1-4.2`.
    pub id: String,
    /// Name of its model, if known.
    pub model: Option<&'static str>,
    /// Serial number, if the device has one and it can be read.
    pub serial: Option<String>,
}

/// Returns the index of the candidate that `wanted` names: its port `usb:BUS-PORT`, else its serial number, else
/// its model. Without a name, returns the only candidate. `None` if none fits; [`absent`] makes the error for that
/// case.
///
/// # Errors
/// Several candidates fit; the message lists them.
pub fn choose(candidates: &[Candidate], wanted: Option<&str>) -> Result<Option<usize>, LinkError> {
    let found = |fits: &dyn Fn(&Candidate) -> bool| -> Vec<usize> {
        (0..candidates.len())
            .filter(|&index| fits(&candidates[index]))
            .collect()
    };
    let fitting = match wanted {
        None => found(&|_| true),
        Some(wanted) => {
            let by_place = found(&|one| one.id == wanted);
            let by_serial = found(&|one| one.serial.as_deref() == Some(wanted));
            let by_model = found(&|one| one.model == Some(wanted));
            [by_place, by_serial, by_model]
                .into_iter()
                .find(|fitting| !fitting.is_empty())
                .unwrap_or_default()
        }
    };
    match fitting[..] {
        [] => Ok(None),
        [one] => Ok(Some(one)),
        _ => Err(LinkError::Unreachable {
            link: wanted.unwrap_or("usb").to_owned(),
            cause: format!(
                "several devices match; name one: {}",
                list(candidates, &fitting)
            ),
        }),
    }
}

/// Returns the error that no candidate fits `wanted`; its message lists the candidates.
#[must_use]
pub fn absent(candidates: &[Candidate], wanted: Option<&str>) -> LinkError {
    let all: Vec<_> = (0..candidates.len()).collect();
    LinkError::Unreachable {
        link: wanted.unwrap_or("usb").to_owned(),
        cause: if candidates.is_empty() {
            "no known camera or MCU is attached".to_owned()
        } else {
            format!(
                "no such device; these are attached: {}",
                list(candidates, &all)
            )
        },
    }
}

fn list(candidates: &[Candidate], which: &[usize]) -> String {
    let told: Vec<_> = which
        .iter()
        .map(|&index| {
            let one = &candidates[index];
            let model = one.model.unwrap_or("unknown");
            match &one.serial {
                Some(serial) => format!("{} ({model}, serial {serial})", one.id),
                None => format!("{} ({model})", one.id),
            }
        })
        .collect();
    told.join(", ")
}

#[cfg(test)]
mod tests {
    use super::*;

    fn candidate(id: &str, model: &'static str, serial: Option<&str>) -> Candidate {
        Candidate {
            id: id.to_owned(),
            model: Some(model),
            serial: serial.map(str::to_owned),
        }
    }

    #[test]
    fn a_device_is_chosen_by_place_serial_number_or_model() {
        let some = [
            candidate("usb:1-4", "davis346", Some("00000123")),
            candidate("usb:2-1.3", "evk4", None),
            candidate("usb:2-1.4", "davis346", Some("00000124")),
        ];
        assert_eq!(choose(&some, Some("usb:2-1.3")).unwrap(), Some(1));
        assert_eq!(choose(&some, Some("00000124")).unwrap(), Some(2));
        assert_eq!(choose(&some, Some("evk4")).unwrap(), Some(1));
        assert_eq!(choose(&some[..1], None).unwrap(), Some(0));
        let told = |wanted| choose(&some, wanted).unwrap_err().to_string();
        assert_eq!(
            told(Some("davis346")),
            "davis346: cannot be reached: several devices match; name one: usb:1-4 (davis346, \
             serial 00000123), usb:2-1.4 (davis346, serial 00000124)"
        );
        assert!(told(None).contains("usb:2-1.3 (evk4)"));
        assert_eq!(choose(&some, Some("dvs128")).unwrap(), None);
        let told = absent(&some[..1], Some("dvs128")).to_string();
        assert!(
            told.contains(
                "no such device; these are attached: usb:1-4 (davis346, serial 00000123)"
            )
        );
        assert_eq!(choose(&[], None).unwrap(), None);
        assert_eq!(
            absent(&[], None).to_string(),
            "usb: cannot be reached: no known camera or MCU is attached"
        );
    }
}
