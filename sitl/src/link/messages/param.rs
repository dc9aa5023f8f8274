//! Parameters: asked for, told, set.

use super::{Target, Text};

/// The longest name of a parameter, bytes.
pub const MAX_NAME: usize = 16;

views! {
    /// A parameter as the vehicle has it.
    ParamValue = PARAM_VALUE_DATA {
        /// A float, or the bytes of an integer: see the vehicle's capabilities.
        0 => value: [u8; 4],
        /// How many parameters there are.
        4 => count: u16,
        /// Its place in the list; 65535 is none.
        6 => index: u16,
        /// Its name.
        8 => name: Text<MAX_NAME>,
        /// MAV_PARAM_TYPE.
        24 => kind: u8,
    }

    /// A parameter as the vehicle shall have it.
    ParamSet = PARAM_SET_DATA {
        /// A float, or the bytes of an integer: see the vehicle's capabilities.
        0 => value: [u8; 4],
        /// Whom it is for.
        4 => target: Target,
        /// Its name.
        6 => name: Text<MAX_NAME>,
        /// MAV_PARAM_TYPE.
        22 => kind: u8,
    }

    /// A request for one parameter.
    ParamRequestRead = PARAM_REQUEST_READ_DATA {
        /// Its place in the list; -1 asks by name.
        0 => index: i16,
        /// Whom it is for.
        2 => target: Target,
        /// Its name.
        4 => name: Text<MAX_NAME>,
    }

    /// A request for all parameters.
    ParamRequestList = PARAM_REQUEST_LIST_DATA {
        /// Whom it is for.
        0 => target: Target,
    }
}
