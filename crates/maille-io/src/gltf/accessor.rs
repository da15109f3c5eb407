//! Accessors: typed views of the buffers, of every component type and shape, strided, sparse.

use maille::mesh::ComponentType;
use serde_json::Value;

use super::Document;
use super::json::{Checked, Fault, Within, index, required_index, text};

/// How many scalars an element has, and how they lie.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Shape {
    Scalar,
    Vec2,
    Vec3,
    Vec4,
    Mat2,
    Mat3,
    Mat4,
}

impl Shape {
    fn from_name(name: &str) -> Option<Self> {
        Some(match name {
            "SCALAR" => Self::Scalar,
            "VEC2" => Self::Vec2,
            "VEC3" => Self::Vec3,
            "VEC4" => Self::Vec4,
            "MAT2" => Self::Mat2,
            "MAT3" => Self::Mat3,
            "MAT4" => Self::Mat4,
            _ => return None,
        })
    }

    pub(super) fn name(self) -> &'static str {
        match self {
            Self::Scalar => "SCALAR",
            Self::Vec2 => "VEC2",
            Self::Vec3 => "VEC3",
            Self::Vec4 => "VEC4",
            Self::Mat2 => "MAT2",
            Self::Mat3 => "MAT3",
            Self::Mat4 => "MAT4",
        }
    }

    pub(super) fn components(self) -> usize {
        match self {
            Self::Scalar => 1,
            Self::Vec2 => 2,
            Self::Vec3 => 3,
            Self::Vec4 | Self::Mat2 => 4,
            Self::Mat3 => 9,
            Self::Mat4 => 16,
        }
    }

    /// Rows of a column; vectors are one column.
    fn rows(self) -> usize {
        match self {
            Self::Mat2 => 2,
            Self::Mat3 => 3,
            Self::Mat4 => 4,
            _ => self.components(),
        }
    }
}

/// How an accessor stores its elements.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Layout {
    pub(super) component: ComponentType,
    pub(super) normalized: bool,
    pub(super) shape: Shape,
}

impl Layout {
    pub(super) const fn floats(shape: Shape) -> Self {
        Self { component: ComponentType::F32, normalized: false, shape }
    }

    /// Byte offset of each scalar in an element: the columns of a matrix start at multiples of four bytes.
    pub(super) fn offsets(self) -> Vec<usize> {
        let (width, rows) = (width(self.component), self.shape.rows());
        let column = if self.shape.components() > rows { (rows * width).next_multiple_of(4) } else { 0 };
        (0..self.shape.components()).map(|i| i / rows * column + i % rows * width).collect()
    }

    /// Bytes from one element to the next in vertex data, where elements start at multiples of four.
    pub(super) fn stride(self) -> usize {
        self.size().next_multiple_of(4)
    }

    /// Bytes of an element, with the padding of its columns.
    pub(super) fn size(self) -> usize {
        let columns = self.shape.components() / self.shape.rows();
        let column = self.shape.rows() * width(self.component);
        if columns > 1 { columns * column.next_multiple_of(4) } else { column }
    }
}

/// Bytes of a scalar.
pub(super) fn width(component: ComponentType) -> usize {
    match component {
        ComponentType::I8 | ComponentType::U8 => 1,
        ComponentType::I16 | ComponentType::U16 => 2,
        ComponentType::I32 | ComponentType::U32 | ComponentType::F32 => 4,
        ComponentType::F64 => 8,
    }
}

/// glTF's number of a component type, `None` for those that it does not have.
pub(super) fn component_code(component: ComponentType) -> Option<u32> {
    Some(match component {
        ComponentType::I8 => 5120,
        ComponentType::U8 => 5121,
        ComponentType::I16 => 5122,
        ComponentType::U16 => 5123,
        ComponentType::U32 => 5125,
        ComponentType::F32 => 5126,
        ComponentType::I32 | ComponentType::F64 => return None,
    })
}

fn component_from_code(code: usize) -> Option<ComponentType> {
    Some(match code {
        5120 => ComponentType::I8,
        5121 => ComponentType::U8,
        5122 => ComponentType::I16,
        5123 => ComponentType::U16,
        5125 => ComponentType::U32,
        5126 => ComponentType::F32,
        _ => return None,
    })
}

/// A checked accessor: everything it names lies within the buffers.
#[derive(Clone)]
pub(super) struct Accessor<'a> {
    pub(super) count: usize,
    pub(super) layout: Layout,
    /// `None`: all zero, where no sparse element says otherwise.
    data: Option<Strided<'a>>,
    /// Elements that replace those of `data`: their indices, ascending, and their values.
    sparse: Option<(Vec<u32>, Strided<'a>)>,
}

#[derive(Clone, Copy)]
struct Strided<'a> {
    bytes: &'a [u8],
    stride: usize,
}

impl<'a> Strided<'a> {
    fn element(&self, index: usize) -> &'a [u8] {
        &self.bytes[index * self.stride..]
    }
}

impl<'a> Accessor<'a> {
    /// Reads and checks accessor `number`.
    pub(super) fn new(document: &'a Document, number: usize) -> Checked<Self> {
        let accessors = document.list("accessors");
        let Some(json) = accessors.get(number) else {
            return Err(Fault::new(format!("accessor {number} does not exist; there are {}", accessors.len())));
        };
        Self::parse(document, json).within_item("accessors", number)
    }

    fn parse(document: &'a Document, json: &Value) -> Checked<Self> {
        let layout = Self::layout_of(json)?;
        let count = required_index(json, "count")?;
        if count >= u32::MAX as usize {
            return Err(Fault::new(format!("{count} elements are more than 32-bit indices can name"))).within("count");
        }
        let data = match index(json, "bufferView")? {
            Some(view) => Some(strided(document, json, view, count, layout)?),
            // zeros cost no bytes in the file; so that a small one cannot ask for gigabytes, they are bounded by its size
            None if count > document.byte_count().max(1 << 16) => {
                return Err(Fault::new(format!("{count} elements without any data"))).within("count");
            }
            None => None,
        };
        let sparse = json.get("sparse").map(|sparse| parse_sparse(document, sparse, count, layout)).transpose();
        Ok(Self { count, layout, data, sparse: sparse.within("sparse")? })
    }

    /// How the accessor of a JSON object stores its elements.
    pub(super) fn layout_of(json: &Value) -> Checked<Layout> {
        let code = required_index(json, "componentType")?;
        let component =
            component_from_code(code).ok_or_else(|| Fault::new(format!("unknown component type {code}")))?;
        let name = text(json, "type");
        let shape = Shape::from_name(name).ok_or_else(|| Fault::new(format!("unknown element type '{name}'")))?;
        let normalized = json.get("normalized").and_then(Value::as_bool).unwrap_or(false);
        Ok(Layout { component, normalized, shape })
    }

    /// The elements named by `pick` as floats, normalised integers as fractions.
    pub(super) fn floats(&self, pick: Option<&[u32]>) -> Vec<f32> {
        let normalized = self.layout.normalized;
        match self.layout.component {
            ComponentType::I8 if normalized => {
                self.gather(pick, |b: [u8; 1]| (f32::from(b[0] as i8) / 127.0).max(-1.0))
            }
            ComponentType::U8 if normalized => self.gather(pick, |b: [u8; 1]| f32::from(b[0]) / 255.0),
            ComponentType::I16 if normalized => {
                self.gather(pick, |b| (f32::from(i16::from_le_bytes(b)) / 32767.0).max(-1.0))
            }
            ComponentType::U16 if normalized => self.gather(pick, |b| f32::from(u16::from_le_bytes(b)) / 65535.0),
            ComponentType::U32 if normalized => {
                self.gather(pick, |b| (f64::from(u32::from_le_bytes(b)) / f64::from(u32::MAX)) as f32)
            }
            ComponentType::I8 => self.gather(pick, |b: [u8; 1]| f32::from(b[0] as i8)),
            ComponentType::U8 => self.gather(pick, |b: [u8; 1]| f32::from(b[0])),
            ComponentType::I16 => self.gather(pick, |b| f32::from(i16::from_le_bytes(b))),
            ComponentType::U16 => self.gather(pick, |b| f32::from(u16::from_le_bytes(b))),
            ComponentType::I32 => self.gather(pick, |b| i32::from_le_bytes(b) as f32),
            ComponentType::U32 => self.gather(pick, |b| u32::from_le_bytes(b) as f32),
            ComponentType::F32 => self.gather(pick, f32::from_le_bytes),
            ComponentType::F64 => self.gather(pick, |b| f64::from_le_bytes(b) as f32),
        }
    }

    /// The elements named by `pick` as integers, `None` if they are not stored as unsigned ones.
    pub(super) fn integers(&self, pick: Option<&[u32]>) -> Option<Vec<u32>> {
        Some(match self.layout.component {
            ComponentType::U8 => self.gather(pick, |b: [u8; 1]| u32::from(b[0])),
            ComponentType::U16 => self.gather(pick, |b| u32::from(u16::from_le_bytes(b))),
            ComponentType::U32 => self.gather(pick, u32::from_le_bytes),
            _ => return None,
        })
    }

    /// Scalars that [`floats`](Self::floats) or [`integers`](Self::integers) give for `elements` elements.
    pub(super) fn scalars(&self, elements: usize) -> u64 {
        elements as u64 * self.layout.shape.components() as u64
    }

    fn gather<T, const N: usize>(&self, pick: Option<&[u32]>, convert: impl Fn([u8; N]) -> T) -> Vec<T> {
        let offsets = self.layout.offsets();
        let scalar = |element: &[u8], offset: usize| {
            convert(element[offset..offset + N].try_into().expect("the slice has N bytes"))
        };
        let mut values = Vec::with_capacity(pick.map_or(self.count, <[u32]>::len) * offsets.len());
        let mut push = |element: usize| match self.element(element) {
            Some(bytes) => values.extend(offsets.iter().map(|&offset| scalar(bytes, offset))),
            None => values.extend(offsets.iter().map(|_| convert([0; N]))),
        };
        match pick {
            Some(elements) => elements.iter().for_each(|&element| push(element as usize)),
            None => (0..self.count).for_each(push),
        }
        values
    }

    fn element(&self, element: usize) -> Option<&'a [u8]> {
        if let Some((indices, values)) = &self.sparse
            && let Ok(place) = indices.binary_search(&(element as u32))
        {
            return Some(values.element(place));
        }
        self.data.map(|data| data.element(element))
    }
}

/// The elements that a buffer view holds for an accessor (or a part of a sparse one).
fn strided<'a>(
    document: &'a Document,
    json: &Value,
    view: usize,
    count: usize,
    layout: Layout,
) -> Checked<Strided<'a>> {
    let (bytes, stride) = document.view(view)?;
    let offset = index(json, "byteOffset")?.unwrap_or(0);
    let stride = stride.unwrap_or_else(|| layout.size());
    if stride < layout.size() {
        return Err(Fault::new(format!("elements of {} bytes lie only {stride} apart", layout.size())));
    }
    // the last element need not be padded
    let last = layout.offsets().last().map_or(0, |offset| offset + width(layout.component));
    let end = match count {
        0 => offset as u64,
        _ => {
            ((count - 1) as u64).saturating_mul(stride as u64).saturating_add(last as u64).saturating_add(offset as u64)
        }
    };
    if end > bytes.len() as u64 {
        let message = format!("{count} elements reach byte {end} of buffer view {view}, which has {}", bytes.len());
        return Err(Fault::new(message));
    }
    Ok(Strided { bytes: &bytes[offset..], stride })
}

fn parse_sparse<'a>(
    document: &'a Document,
    json: &Value,
    count: usize,
    layout: Layout,
) -> Checked<(Vec<u32>, Strided<'a>)> {
    let replaced = required_index(json, "count")?;
    let part = |key: &str| json.get(key).ok_or_else(|| Fault::new(format!("'{key}' is missing")));
    let (indices, values) = (part("indices")?, part("values")?);
    let code = required_index(indices, "componentType").within("indices")?;
    let component = component_from_code(code).ok_or_else(|| Fault::new(format!("unknown component type {code}")))?;
    let index_layout = Layout { component, normalized: false, shape: Shape::Scalar };
    let data = required_index(indices, "bufferView")
        .and_then(|view| strided(document, indices, view, replaced, index_layout))
        .within("indices")?;
    let values = required_index(values, "bufferView")
        .and_then(|view| strided(document, values, view, replaced, layout))
        .within("values")?;
    let indices = Accessor { count: replaced, layout: index_layout, data: Some(data), sparse: None };
    let indices = indices.integers(None).ok_or_else(|| Fault::new("the indices are not unsigned integers"))?;
    if !indices.is_sorted_by(|a, b| a < b) || indices.last().is_some_and(|&last| last as usize >= count) {
        return Err(Fault::new(format!("the indices do not ascend below {count}"))).within("indices");
    }
    Ok((indices, values))
}

/// Writes `min` and `max` anew into the accessors that have them and lie in one of `views` (ascending), whose bytes
/// have just been decompressed: lossy codecs move the extremes a little.
pub(super) fn refresh_bounds(json: &mut Value, buffers: &mut Vec<Vec<u8>>, views: &[usize]) -> Checked<()> {
    let in_views = |accessor: &Value| {
        let view = index(accessor, "bufferView").ok().flatten();
        accessor.get("min").is_some() && view.is_some_and(|view| views.binary_search(&view).is_ok())
    };
    let accessors: Vec<usize> = (super::json::list(json, "accessors")?.iter().enumerate())
        .filter_map(|(i, accessor)| in_views(accessor).then_some(i))
        .collect();
    if accessors.is_empty() {
        return Ok(());
    }
    let document = Document::new(json.take(), std::mem::take(buffers), None)?;
    let bounds: Vec<_> =
        accessors.iter().map(|&i| Ok(bounds(&Accessor::new(&document, i)?))).collect::<Checked<_>>()?;
    (*json, *buffers) = (document.json, document.buffers);
    for (i, (low, high)) in accessors.into_iter().zip(bounds) {
        json["accessors"][i]["min"] = low.into();
        json["accessors"][i]["max"] = high.into();
    }
    Ok(())
}

/// Smallest and largest stored value of each component, as JSON numbers; normalised integers stay integers.
fn bounds(accessor: &Accessor<'_>) -> (Vec<Value>, Vec<Value>) {
    let components = accessor.layout.shape.components();
    let raw = Accessor { layout: Layout { normalized: false, ..accessor.layout }, ..accessor.clone() };
    bounds_of(&raw.floats(None), components, accessor.layout.component)
}

/// Smallest and largest value of each component, as JSON numbers of the kind that a component type asks for.
pub(super) fn bounds_of(values: &[f32], components: usize, component: ComponentType) -> (Vec<Value>, Vec<Value>) {
    let extreme = |pick: fn(f32, f32) -> f32, component_index: usize| {
        let column = values.iter().skip(component_index).step_by(components).copied();
        let value = f64::from(column.reduce(pick).unwrap_or(0.0));
        if component == ComponentType::F32 { Value::from(value) } else { Value::from(value as i64) }
    };
    let each = |pick: fn(f32, f32) -> f32| (0..components).map(|i| extreme(pick, i)).collect();
    (each(f32::min), each(f32::max))
}
