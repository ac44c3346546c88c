//! Tables as Arrow IPC files: written whole, read through a memory map without copying.

mod mapped;
mod table;

use std::fs::{self, File};
use std::path::Path;
use std::sync::Arc;

use arrow_array::types::{
    ArrowPrimitiveType, Float32Type, Float64Type, Int64Type, UInt16Type, UInt32Type,
};
use arrow_array::{
    Array, ArrayRef, FixedSizeBinaryArray, FixedSizeListArray, Float32Array, PrimitiveArray,
    RecordBatch,
};
use arrow_buffer::{ArrowNativeType, Buffer, ScalarBuffer};
use arrow_ipc::reader::read_footer_length;
use arrow_ipc::writer::FileWriter;
use arrow_ipc::{
    Buffer as IpcBuffer, Field as IpcField, FieldNode, Precision, root_as_footer, root_as_message,
};
use arrow_schema::{ArrowError, DataType, Field, Schema};

use crate::Error;
use mapped::map_file;
pub(crate) use table::{Fingerprint, Table, broken, length_and_crc32c};

/// Length of the footer, and the format's name, at the end of a file.
const TRAILER_BYTES: usize = 10;

/// A column without missing values.
#[derive(Clone, Debug)]
pub(crate) enum Column {
    F64(ScalarBuffer<f64>),
    F32(ScalarBuffer<f32>),
    I64(ScalarBuffer<i64>),
    U32(ScalarBuffer<u32>),
    U16(ScalarBuffer<u16>),
    /// Rows of `width` bytes.
    Bytes {
        width: usize,
        values: Buffer,
    },
    /// Rows of `width` numbers.
    F32List {
        width: usize,
        values: ScalarBuffer<f32>,
    },
}

fn list_item() -> Arc<Field> {
    Arc::new(Field::new("item", DataType::Float32, false))
}

fn primitive<T: ArrowPrimitiveType>(values: &ScalarBuffer<T::Native>) -> ArrayRef {
    Arc::new(PrimitiveArray::<T>::new(values.clone(), None))
}

impl Column {
    fn to_array(&self) -> Result<ArrayRef, ArrowError> {
        Ok(match self {
            Self::F64(v) => primitive::<Float64Type>(v),
            Self::F32(v) => primitive::<Float32Type>(v),
            Self::I64(v) => primitive::<Int64Type>(v),
            Self::U32(v) => primitive::<UInt32Type>(v),
            Self::U16(v) => primitive::<UInt16Type>(v),
            Self::Bytes { width, values } => Arc::new(FixedSizeBinaryArray::try_new(
                *width as i32,
                values.clone(),
                None,
            )?),
            Self::F32List { width, values } => {
                let items = Arc::new(Float32Array::new(values.clone(), None));
                Arc::new(FixedSizeListArray::try_new(
                    list_item(),
                    *width as i32,
                    items,
                    None,
                )?)
            }
        })
    }
}

/// A named column.
pub(crate) type NamedColumn = (&'static str, Column);

/// Writes a table as one record batch, to another name first, so that a file by this name is always whole.
pub(crate) fn write_table(path: &Path, columns: &[NamedColumn]) -> Result<(), Error> {
    let refuse = |e: ArrowError| Error::io(path)(std::io::Error::other(e));
    let mut fields = Vec::new();
    let mut arrays = Vec::new();
    for (name, column) in columns {
        let array = column.to_array().map_err(refuse)?;
        fields.push(Field::new(*name, array.data_type().clone(), false));
        arrays.push(array);
    }
    let schema = Arc::new(Schema::new(fields));
    let batch = RecordBatch::try_new(schema.clone(), arrays).map_err(refuse)?;
    let partial = path.with_extension("partial");
    let file = File::create(&partial).map_err(Error::io(&partial))?;
    let mut writer = FileWriter::try_new_buffered(file, &schema).map_err(refuse)?;
    writer.write(&batch).map_err(refuse)?;
    writer.finish().map_err(refuse)?;
    let buffered = writer.into_inner().map_err(refuse)?;
    let file = buffered
        .into_inner()
        .map_err(|e| Error::io(&partial)(e.into_error()))?;
    file.sync_all().map_err(Error::io(&partial))?;
    fs::rename(&partial, path).map_err(Error::io(path))
}

/// The bytes of a table's file, mapped into memory.
fn map_table(path: &Path) -> Result<Buffer, Error> {
    Ok(Buffer::from(map_file(path)?))
}

/// Reads the columns of a table from its file's bytes; `wanted` names them in order.
pub(crate) fn read_table(
    path: &Path,
    bytes: &Buffer,
    wanted: &[&'static str],
) -> Result<Vec<Column>, Error> {
    let refuse = |reason: String| Error::MapFile {
        path: path.to_owned(),
        reason,
    };
    let columns = decode(bytes).map_err(|reason| refuse(reason.to_owned()))?;
    let column = |name: &&'static str| {
        let found = columns.iter().find(|(known, _)| known == name);
        found
            .map(|(_, column)| column.clone())
            .ok_or(refuse(format!("no column {name}")))
    };
    wanted.iter().map(column).collect()
}

/// The columns of the one record batch that a file of ours has. Arrow's own reader takes a file at its word, and panics where
/// that is wrong; here every length is compared first.
fn decode(bytes: &Buffer) -> Result<Vec<(String, Column)>, &'static str> {
    const CUT_OFF: &str = "the record batch is truncated";
    let tail = bytes.len().checked_sub(TRAILER_BYTES);
    let tail = tail.ok_or("too short for an Arrow file")?;
    let trailer = bytes[tail..].try_into().map_err(|_| "no trailer")?;
    let footer_length = read_footer_length(trailer).map_err(|_| "not an Arrow file")?;
    let start = tail
        .checked_sub(footer_length)
        .ok_or("the footer is truncated")?;
    let footer = root_as_footer(&bytes[start..tail]).map_err(|_| "the footer is damaged")?;
    let schema = footer.schema().ok_or("no schema")?;
    let block = footer
        .recordBatches()
        .and_then(|blocks| blocks.iter().next())
        .ok_or("no record batch")?;
    let number = |value: i64| usize::try_from(value).map_err(|_| "a negative length");
    let from = number(block.offset())?;
    let metadata = number(block.metaDataLength().into())?;
    let body = number(block.bodyLength())?;
    let body_at = from.checked_add(metadata).ok_or(CUT_OFF)?;
    let end = body_at.checked_add(body).ok_or(CUT_OFF)?;
    if end > start {
        return Err(CUT_OFF);
    }
    // Continuation marker and length come before the message.
    let message = bytes.get(from + 8..body_at).ok_or(CUT_OFF)?;
    let message = root_as_message(message).map_err(|_| "the record batch is damaged")?;
    let batch = message.header_as_record_batch().ok_or("no record batch")?;
    if batch.compression().is_some() {
        return Err("it is compressed");
    }
    let mut parts = Parts {
        body: bytes.slice_with_length(body_at, body),
        nodes: batch.nodes().ok_or("no columns")?.iter().collect(),
        buffers: batch.buffers().ok_or("no columns")?.iter().collect(),
    };
    parts.nodes.reverse();
    parts.buffers.reverse();
    let rows = number(batch.length())?;
    let fields = schema.fields().ok_or("no columns")?;
    let column = |field| {
        let (name, column) = parts.column(field, rows)?;
        Ok((name.to_owned(), column))
    };
    fields.iter().map(column).collect()
}

/// What is left of a record batch, the next at the end.
struct Parts<'a> {
    body: Buffer,
    nodes: Vec<&'a FieldNode>,
    buffers: Vec<&'a IpcBuffer>,
}

impl Parts<'_> {
    fn column<'f>(
        &mut self,
        field: IpcField<'f>,
        rows: usize,
    ) -> Result<(&'f str, Column), &'static str> {
        const OTHER: &str = "a column has another type";
        let name = field.name().ok_or("a column has no name")?;
        self.node(rows)?;
        let float = |field: &IpcField<'f>| field.type_as_floating_point().map(|f| f.precision());
        let column = if let Some(precision) = float(&field) {
            match precision {
                Precision::DOUBLE => Column::F64(self.numbers(rows)?),
                Precision::SINGLE => Column::F32(self.numbers(rows)?),
                _ => return Err(OTHER),
            }
        } else if let Some(int) = field.type_as_int() {
            match (int.is_signed(), int.bitWidth()) {
                (true, 64) => Column::I64(self.numbers(rows)?),
                (false, 32) => Column::U32(self.numbers(rows)?),
                (false, 16) => Column::U16(self.numbers(rows)?),
                _ => return Err(OTHER),
            }
        } else if let Some(binary) = field.type_as_fixed_size_binary() {
            let width = usize::try_from(binary.byteWidth()).map_err(|_| OTHER)?;
            self.validity()?;
            Column::Bytes {
                width,
                values: self.values(rows.checked_mul(width).ok_or(OTHER)?)?,
            }
        } else if let Some(list) = field.type_as_fixed_size_list() {
            let width = usize::try_from(list.listSize()).map_err(|_| OTHER)?;
            let items = field.children().filter(|children| children.len() == 1);
            let item = items.ok_or(OTHER)?.get(0);
            let count = rows.checked_mul(width).ok_or(OTHER)?;
            self.validity()?;
            self.node(count)?;
            match float(&item) {
                Some(Precision::SINGLE) => Column::F32List {
                    width,
                    values: self.numbers(count)?,
                },
                _ => return Err(OTHER),
            }
        } else {
            return Err(OTHER);
        };
        Ok((name, column))
    }

    /// The next node must have so many values, none of them missing.
    fn node(&mut self, values: usize) -> Result<(), &'static str> {
        let node = self.nodes.pop().ok_or("a column is missing")?;
        let agrees = usize::try_from(node.length()) == Ok(values) && node.null_count() == 0;
        agrees
            .then_some(())
            .ok_or("a column has another length, or values are missing")
    }

    /// Where none is missing there is no need to know which.
    fn validity(&mut self) -> Result<(), &'static str> {
        self.buffers.pop().map(|_| ()).ok_or("a column is missing")
    }

    /// The next buffer, its first `bytes`.
    fn values(&mut self, bytes: usize) -> Result<Buffer, &'static str> {
        let buffer = self.buffers.pop().ok_or("a column is missing")?;
        let place = (buffer.offset().try_into(), buffer.length().try_into());
        let (Ok(offset), Ok(length)) = place else {
            return Err("a column has a negative length");
        };
        let (offset, length): (usize, usize) = (offset, length);
        let end = offset.checked_add(length);
        let fits = bytes <= length && end.is_some_and(|end| end <= self.body.len());
        fits.then(|| self.body.slice_with_length(offset, bytes))
            .ok_or("a column is truncated")
    }

    fn numbers<T: ArrowNativeType>(
        &mut self,
        count: usize,
    ) -> Result<ScalarBuffer<T>, &'static str> {
        self.validity()?;
        let bytes = count.checked_mul(size_of::<T>());
        let values = self.values(bytes.ok_or("a column is too long")?)?;
        let address = values.as_ptr().addr();
        if !address.is_multiple_of(align_of::<T>()) {
            return Err("a column is not aligned");
        }
        Ok(ScalarBuffer::new(values, 0, count))
    }
}
