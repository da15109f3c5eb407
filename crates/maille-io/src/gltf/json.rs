//! Checked access to the JSON of a glTF, and faults that know their place in it.

use std::fmt;

use serde_json::Value;

use crate::ReadError;
use crate::error::Place;

/// What is wrong, and where; the place grows outwards as the error travels up.
#[derive(Debug)]
pub(super) struct Fault {
    place: String,
    message: String,
    remedy: Option<&'static str>,
}

pub(super) type Checked<T> = Result<T, Fault>;

impl Fault {
    pub(super) fn new(message: impl Into<String>) -> Self {
        Self { place: String::new(), message: message.into(), remedy: None }
    }

    pub(super) fn with_remedy(mut self, remedy: &'static str) -> Self {
        self.remedy = Some(remedy);
        self
    }

    fn within(mut self, outer: &str) -> Self {
        self.place = if self.place.is_empty() { outer.to_owned() } else { format!("{outer}.{}", self.place) };
        self
    }
}

impl fmt::Display for Fault {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.place.as_str() {
            "" => f.write_str(&self.message),
            place => write!(f, "{place}: {}", self.message),
        }
    }
}

impl From<Fault> for ReadError {
    fn from(fault: Fault) -> Self {
        let error = Self::new(fault.message);
        let error = if fault.place.is_empty() { error } else { error.at(Place::Part(fault.place)) };
        match fault.remedy {
            Some(remedy) => error.with_remedy(remedy),
            None => error,
        }
    }
}

/// Says in which part of the document a fault lies.
pub(super) trait Within<T> {
    /// Inside the member `key`.
    fn within(self, key: &str) -> Checked<T>;
    /// Inside element `index` of the array `key`.
    fn within_item(self, key: &str, index: usize) -> Checked<T>;
}

impl<T> Within<T> for Checked<T> {
    fn within(self, key: &str) -> Self {
        self.map_err(|fault| fault.within(key))
    }

    fn within_item(self, key: &str, index: usize) -> Self {
        self.map_err(|fault| fault.within(&format!("{key}[{index}]")))
    }
}

/// The elements of an array member, none when it is absent.
pub(super) fn list<'a>(object: &'a Value, key: &str) -> Checked<&'a [Value]> {
    match object.get(key) {
        None => Ok(&[]),
        Some(Value::Array(items)) => Ok(items),
        Some(other) => Err(Fault::new(format!("expected an array, found {}", kind(other)))).within(key),
    }
}

/// The members of an object member, none when it is absent.
pub(super) fn members<'a>(object: &'a Value, key: &str) -> Checked<Vec<(&'a str, &'a Value)>> {
    match object.get(key) {
        None => Ok(Vec::new()),
        Some(Value::Object(map)) => Ok(map.iter().map(|(key, value)| (key.as_str(), value)).collect()),
        Some(other) => Err(Fault::new(format!("expected an object, found {}", kind(other)))).within(key),
    }
}

/// A non-negative integer; 5.0 is one, too, as glTF has it.
pub(super) fn as_index(value: &Value) -> Checked<usize> {
    let whole = |x: f64| (x >= 0.0 && x < 2f64.powi(53) && x.fract() == 0.0).then_some(x as u64);
    let index = value.as_u64().or_else(|| value.as_f64().and_then(whole)).and_then(|x| usize::try_from(x).ok());
    index.ok_or_else(|| Fault::new(format!("expected a non-negative integer, found {}", kind(value))))
}

/// A non-negative integer member.
pub(super) fn index(object: &Value, key: &str) -> Checked<Option<usize>> {
    object.get(key).map(as_index).transpose().within(key)
}

/// A non-negative integer member that must be there.
pub(super) fn required_index(object: &Value, key: &str) -> Checked<usize> {
    index(object, key)?.ok_or_else(|| Fault::new(format!("'{key}' is missing")))
}

/// A list of exactly `N` numbers.
pub(super) fn numbers<const N: usize>(object: &Value, key: &str) -> Checked<Option<[f64; N]>> {
    let Some(value) = object.get(key) else { return Ok(None) };
    let found: Option<Vec<f64>> = value.as_array().and_then(|items| items.iter().map(Value::as_f64).collect());
    let numbers = found.and_then(|numbers| <[f64; N]>::try_from(numbers).ok());
    numbers.map(Some).ok_or_else(|| Fault::new(format!("expected {N} numbers"))).within(key)
}

/// A list of numbers, empty when absent.
pub(super) fn number_list(object: &Value, key: &str) -> Checked<Vec<f64>> {
    let number = |value: &Value| value.as_f64().ok_or_else(|| Fault::new("expected numbers"));
    list(object, key)?.iter().map(number).collect::<Checked<_>>().within(key)
}

/// A text member, empty when absent.
pub(super) fn text<'a>(object: &'a Value, key: &str) -> &'a str {
    object.get(key).and_then(Value::as_str).unwrap_or_default()
}

/// An extension of an object.
pub(super) fn extension<'a>(object: &'a Value, name: &str) -> Option<&'a Value> {
    object.get("extensions")?.get(name)
}

/// Takes an extension out of an object.
pub(super) fn remove_extension(object: &mut Value, name: &str) {
    let Some(extensions) = object.get_mut("extensions").and_then(Value::as_object_mut) else { return };
    extensions.shift_remove(name);
    if extensions.is_empty() {
        remove(object, "extensions");
    }
}

/// Takes a member out of an object; the others keep their order.
pub(super) fn remove(object: &mut Value, key: &str) {
    if let Some(map) = object.as_object_mut() {
        map.shift_remove(key);
    }
}

/// Takes an extension out of the lists of those used and required.
pub(super) fn undeclare(json: &mut Value, name: &str) {
    for key in ["extensionsUsed", "extensionsRequired"] {
        let Some(names) = json.get_mut(key).and_then(Value::as_array_mut) else { continue };
        names.retain(|other| other != name);
        if names.is_empty() {
            remove(json, key);
        }
    }
}

/// Puts an extension on the list of those used.
pub(super) fn declare(json: &mut Value, name: &str) {
    if declares(json, name) {
        return;
    }
    match json.get_mut("extensionsUsed").and_then(Value::as_array_mut) {
        Some(names) => names.push(name.into()),
        None => json["extensionsUsed"] = serde_json::json!([name]),
    }
}

/// Whether the document says that it uses an extension.
pub(super) fn declares(json: &Value, name: &str) -> bool {
    let names = json.get("extensionsUsed").and_then(Value::as_array);
    names.is_some_and(|names| names.iter().any(|other| other == name))
}

fn kind(value: &Value) -> String {
    match value {
        Value::Null => "null".to_owned(),
        Value::Bool(_) => "a boolean".to_owned(),
        Value::Number(number) => number.to_string(),
        Value::String(_) => "a text".to_owned(),
        Value::Array(_) => "an array".to_owned(),
        Value::Object(_) => "an object".to_owned(),
    }
}
