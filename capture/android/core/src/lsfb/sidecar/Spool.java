package lsfb.sidecar;

import java.io.Closeable;
import java.io.File;
import java.io.IOException;
import java.io.RandomAccessFile;
import java.util.TreeMap;

/**
 * DATA envelopes on the phone's own storage until the rig has them on its disk.
 *
 * <p>Files of a few megabytes, {@code N.spool}, N the number of their first envelope; each record is length, CRC-32C and the envelope.
 * A phone that was killed finds all that was synced; what it was writing at that moment is cut off. A file whose envelopes are all
 * acknowledged is removed. How far the session has got stands in {@code acknowledged}, so that an empty spool does not begin anew.
 */
public final class Spool implements Closeable {
  private static final long FILE_BYTES = 8L << 20;
  private static final int HEAD_BYTES = 8;

  private final File folder;
  /** First number of each file, and where its records lie. */
  private final TreeMap<Long, File> files = new TreeMap<>();
  private RandomAccessFile open;
  private long lastSeq;
  private long syncedSeq;
  private long acknowledged;
  /** Where the next record is read, so that nothing is searched twice. */
  private RandomAccessFile reading;
  private long readingFile = -1;
  private long nextToRead;

  public Spool(File folder) throws IOException {
    this.folder = folder;
    if (!folder.isDirectory() && !folder.mkdirs()) {
      throw new IOException(folder + " cannot be created");
    }
    File mark = new File(folder, "acknowledged");
    if (mark.exists()) {
      try (RandomAccessFile in = new RandomAccessFile(mark, "r")) {
        acknowledged = in.length() >= 8 ? in.readLong() : 0;
      }
    }
    lastSeq = acknowledged;
    File[] found = folder.listFiles((dir, name) -> name.endsWith(".spool"));
    for (File file : found == null ? new File[0] : found) {
      files.put(Long.parseLong(file.getName().replace(".spool", "")), file);
    }
    if (!files.isEmpty()) {
      long first = files.lastKey();
      lastSeq = Math.max(lastSeq, first - 1 + wholeRecords(files.get(first)));
    }
    // It was read from there.
    syncedSeq = lastSeq;
  }

  /** Number of the last envelope that was put here. */
  public synchronized long lastSeq() {
    return lastSeq;
  }

  /** Number of the first that the rig does not have. */
  public synchronized long firstUnacknowledged() {
    return acknowledged + 1;
  }

  /** Keeps one; it is safe after {@link #sync}. */
  public synchronized void put(Envelope envelope) throws IOException {
    if (envelope.seq != lastSeq + 1) {
      throw new IOException("DATA " + envelope.seq + " is not the next after " + lastSeq);
    }
    byte[] bytes = envelope.emit();
    if (open == null || open.length() > FILE_BYTES) {
      if (open != null) {
        open.getFD().sync();
        open.close();
      }
      File file = new File(folder, envelope.seq + ".spool");
      open = new RandomAccessFile(file, "rw");
      open.setLength(0);
      files.put(envelope.seq, file);
    }
    open.seek(open.length());
    java.nio.ByteBuffer record = java.nio.ByteBuffer.allocate(HEAD_BYTES + bytes.length);
    record.putInt(bytes.length).putInt(Crc32c.of(bytes)).put(bytes);
    open.write(record.array());
    lastSeq = envelope.seq;
  }

  /** Puts to the disk what was kept; several times a second is enough. */
  public synchronized void sync() throws IOException {
    if (open != null) {
      open.getFD().sync();
    }
    syncedSeq = lastSeq;
  }

  /** Number of the last that no power cut takes away. Only such are sent: a number that the rig has must never be given twice. */
  public synchronized long syncedSeq() {
    return syncedSeq;
  }

  /** The envelope of a number, or null where it is not here. In order it costs one read. */
  public synchronized byte[] read(long seq) throws IOException {
    Long first = files.floorKey(seq);
    if (first == null || seq > lastSeq || seq <= acknowledged) {
      return null;
    }
    if (readingFile != first || seq < nextToRead) {
      if (reading != null) {
        reading.close();
      }
      reading = new RandomAccessFile(files.get(first), "r");
      readingFile = first;
      nextToRead = first;
    }
    byte[] record = null;
    while (nextToRead <= seq) {
      record = next(reading);
      if (record == null) {
        throw new IOException("the spool is damaged at DATA " + nextToRead);
      }
      nextToRead++;
    }
    return record;
  }

  /** Forgets all up to this number. */
  public synchronized void acknowledge(long seq) throws IOException {
    if (seq <= acknowledged) {
      return;
    }
    if (seq > lastSeq) {
      throw new ProtocolException("DATA " + seq + " is acknowledged, but " + lastSeq + " was the last");
    }
    acknowledged = seq;
    try (RandomAccessFile out = new RandomAccessFile(new File(folder, "acknowledged"), "rw")) {
      out.writeLong(seq);
    }
    // All but the one that is written.
    while (files.size() > 1 && files.higherKey(files.firstKey()) <= seq + 1) {
      long first = files.firstKey();
      if (readingFile == first) {
        reading.close();
        reading = null;
        readingFile = -1;
      }
      // One that stays is read over at the next start.
      files.remove(first).delete();
    }
  }

  @Override
  public synchronized void close() throws IOException {
    sync();
    for (RandomAccessFile file : new RandomAccessFile[] {open, reading}) {
      if (file != null) {
        file.close();
      }
    }
  }

  private static byte[] next(RandomAccessFile file) throws IOException {
    long left = file.length() - file.getFilePointer();
    if (left < HEAD_BYTES) {
      return null;
    }
    int length = file.readInt();
    int crc = file.readInt();
    if (length < 0 || length > left - HEAD_BYTES) {
      return null;
    }
    byte[] bytes = new byte[length];
    file.readFully(bytes);
    return Crc32c.of(bytes) == crc ? bytes : null;
  }

  private static long wholeRecords(File file) throws IOException {
    long records = 0;
    try (RandomAccessFile in = new RandomAccessFile(file, "rw")) {
      long end = 0;
      while (next(in) != null) {
        records++;
        end = in.getFilePointer();
      }
      // What was being written when the phone was killed.
      in.setLength(end);
    }
    return records;
  }
}
