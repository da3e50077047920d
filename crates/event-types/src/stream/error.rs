//! Why events could not be read or written.

use std::error::Error as StdError;
use std::fmt;
use std::io;

/// A result whose error is an [`Error`].
pub type Result<T, E = Error> = std::result::Result<T, E>;

/// What is behind an [`Error`], and so what can be done about it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum ErrorKind {
    /// The system: no such file, no right to it, a full disk.
    Io(io::ErrorKind),
    /// What was read is not what its format says: damaged, cut off, or never right. The events before it were given.
    Damaged,
    /// A format, or a part of one, that is not read or not written.
    Unsupported,
    /// The file leaves open what the caller has to say: a size, a unit, which columns are which.
    Undecided,
    /// The output's format cannot hold an event or a sensor.
    CannotHold,
    /// The caller asked for what cannot be done, or what would destroy something; nothing was done.
    Refused,
    /// Something else, in what gives or takes the events.
    Other,
}

/// Why events could not be read or written.
///
/// Its text is one line for people, which names the file, the offset and what to do; `{:#}` has the causes behind it.
pub struct Error(Box<Inner>);

struct Inner {
    kind: ErrorKind,
    /// `None`: what `cause` says.
    what: Option<String>,
    cause: Option<Box<dyn StdError + Send + Sync>>,
}

impl Error {
    /// An error of `kind`; `what` is its text.
    pub fn new(kind: ErrorKind, what: impl Into<String>) -> Self {
        Self(Box::new(Inner {
            kind,
            what: Some(what.into()),
            cause: None,
        }))
    }

    /// An error of something that gives or takes events and has errors of its own.
    pub fn other(cause: impl Into<Box<dyn StdError + Send + Sync>>) -> Self {
        Self::caused(ErrorKind::Other, cause.into())
    }

    fn caused(kind: ErrorKind, cause: Box<dyn StdError + Send + Sync>) -> Self {
        // What has been an error of this type stays one.
        let cause = match cause.downcast::<Self>() {
            Ok(error) => return *error,
            Err(cause) => cause,
        };
        let kind = match cause.downcast_ref::<io::Error>() {
            Some(error) => ErrorKind::Io(error.kind()),
            None => kind,
        };
        Self(Box::new(Inner {
            kind,
            what: None,
            cause: Some(cause),
        }))
    }

    /// What is behind it.
    #[must_use]
    pub fn kind(&self) -> ErrorKind {
        self.0.kind
    }

    /// The system's error behind it, where there is one.
    #[must_use]
    pub fn io(&self) -> Option<&io::Error> {
        let cause = self.0.cause.as_deref()?;
        let inner = || cause.downcast_ref().and_then(Self::io);
        cause.downcast_ref().or_else(inner)
    }

    /// The same error, of another kind.
    #[must_use]
    pub fn of_kind(mut self, kind: ErrorKind) -> Self {
        self.0.kind = kind;
        self
    }

    /// The same error behind a text that says where it was met.
    #[must_use]
    pub fn context(self, what: impl fmt::Display) -> Self {
        Self(Box::new(Inner {
            kind: self.0.kind,
            what: Some(what.to_string()),
            cause: Some(self.into()),
        }))
    }
}

impl fmt::Display for Error {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match (&self.0.what, &self.0.cause) {
            (Some(what), _) => f.write_str(what)?,
            (None, Some(cause)) => write!(f, "{cause}")?,
            (None, None) => {}
        }
        let mut cause = self.source().filter(|_| f.alternate());
        while let Some(error) = cause {
            write!(f, ": {error}")?;
            cause = error.source();
        }
        Ok(())
    }
}

impl fmt::Debug for Error {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{:?}: {self:#}", self.0.kind)
    }
}

impl StdError for Error {
    fn source(&self) -> Option<&(dyn StdError + 'static)> {
        let cause = self.0.cause.as_deref()?;
        match &self.0.what {
            Some(_) => Some(cause),
            None => cause.source(),
        }
    }
}

impl From<io::Error> for Error {
    fn from(error: io::Error) -> Self {
        Self::caused(ErrorKind::Other, error.into())
    }
}

/// Says of a failure where it was met, and makes it an [`Error`].
pub trait Context<T> {
    /// Puts `what` before the error: one of the system keeps its kind, and any other is [`ErrorKind::Damaged`].
    ///
    /// # Errors
    /// There was one, or no value.
    fn context(self, what: impl fmt::Display) -> Result<T>;

    /// As [`Context::context`], with a text that is made where there is an error.
    ///
    /// # Errors
    /// As there.
    fn with_context<D: fmt::Display>(self, what: impl FnOnce() -> D) -> Result<T>;
}

impl<T, E: StdError + Send + Sync + 'static> Context<T> for Result<T, E> {
    fn context(self, what: impl fmt::Display) -> Result<T> {
        self.with_context(|| what)
    }

    fn with_context<D: fmt::Display>(self, what: impl FnOnce() -> D) -> Result<T> {
        self.map_err(|error| Error::caused(ErrorKind::Damaged, error.into()).context(what()))
    }
}

impl<T> Context<T> for Option<T> {
    fn context(self, what: impl fmt::Display) -> Result<T> {
        self.with_context(|| what)
    }

    fn with_context<D: fmt::Display>(self, what: impl FnOnce() -> D) -> Result<T> {
        self.ok_or_else(|| Error::new(ErrorKind::Damaged, what().to_string()))
    }
}

/// An [`Error`](crate::stream::Error) of a kind, with a text as `format!` takes it.
///
/// ```
/// use event_types::error;
/// use event_types::stream::ErrorKind;
///
/// let byte = 7;
/// let error = error!(Damaged, "byte {byte}: no event");
/// assert_eq!(error.to_string(), "byte 7: no event");
/// assert_eq!(error.kind(), ErrorKind::Damaged);
/// ```
#[macro_export]
macro_rules! error {
    ($kind:ident, $($text:tt)+) => {
        $crate::stream::Error::new($crate::stream::ErrorKind::$kind, ::std::format!($($text)+))
    };
}

/// Returns the [`error!`](crate::error) of a kind and a text.
#[macro_export]
macro_rules! bail {
    ($kind:ident, $($text:tt)+) => {
        return ::core::result::Result::Err(::core::convert::From::from($crate::error!($kind, $($text)+)))
    };
}

/// Returns the [`error!`](crate::error) of a kind and a text unless a condition holds.
#[macro_export]
macro_rules! ensure {
    ($condition:expr, $kind:ident, $($text:tt)+) => {
        if !$condition {
            $crate::bail!($kind, $($text)+);
        }
    };
}

#[cfg(test)]
mod tests {
    use super::*;

    fn fails() -> Result<()> {
        let absent = io::Error::new(io::ErrorKind::NotFound, "no such file");
        Err(absent).context("a.raw: cannot be opened")
    }

    #[test]
    fn causes_stand_behind_what_was_met() {
        let error = fails().with_context(|| "converting").unwrap_err();
        assert_eq!(error.to_string(), "converting");
        let chain = "converting: a.raw: cannot be opened: no such file";
        assert_eq!(format!("{error:#}"), chain);
        assert_eq!(error.kind(), ErrorKind::Io(io::ErrorKind::NotFound));
        assert_eq!(error.io().unwrap().to_string(), "no such file");
    }

    #[test]
    fn errors_of_others_keep_their_text_and_their_causes() {
        let inner = fails().unwrap_err();
        let error = Error::other(inner);
        assert_eq!(error.kind(), ErrorKind::Io(io::ErrorKind::NotFound));
        let error = Error::other("a word").context("b");
        assert_eq!(format!("{error:#}"), "b: a word");
        assert_eq!(error.kind(), ErrorKind::Other);
        let error: Error = io::Error::other("disk").into();
        assert_eq!(format!("{error:#}"), "disk");
        let none: Option<u8> = None;
        assert_eq!(
            none.context("byte 3").unwrap_err().kind(),
            ErrorKind::Damaged
        );
    }
}
