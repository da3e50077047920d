//! USB link of event cameras and of the encoder's MCU.
