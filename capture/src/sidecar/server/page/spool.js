// What is measured lies in the browser's database until the rig has it: closing the page, the browser or the phone loses nothing.

const STORES = ["state", "data", "channels"];
// Measured data that wait to be written together, milliseconds.
const WRITE_EVERY_MS = 50;

function request(made) {
  return new Promise((resolve, reject) => {
    made.onsuccess = () => resolve(made.result);
    made.onerror = () => reject(made.error);
  });
}

function finished(transaction) {
  return new Promise((resolve, reject) => {
    transaction.oncomplete = () => resolve();
    transaction.onabort = () => reject(transaction.error ?? new Error("the browser's storage failed"));
  });
}

export class Spool {
  waiting = [];
  // Whoever writes waits for the one before: numbers have no gap.
  last = Promise.resolve();

  static async open() {
    const opening = indexedDB.open("lsfb-sidecar", 1);
    opening.onupgradeneeded = () => {
      for (const store of STORES) opening.result.createObjectStore(store);
    };
    const spool = new Spool();
    spool.database = await request(opening);
    const read = spool.database.transaction(STORES);
    spool.device = (await request(read.objectStore("state").get("device"))) ?? null;
    spool.session = (await request(read.objectStore("state").get("session"))) ?? null;
    spool.count = await request(spool.database.transaction("data").objectStore("data").count());
    return spool;
  }

  // Bytes of the messages that wait.
  get bytes() {
    return this.session?.bytes ?? 0;
  }

  // The name and the key by which the rig knows this browser.
  async keepDevice(device) {
    const write = this.database.transaction("state", "readwrite");
    write.objectStore("state").put(device, "device");
    await finished(write);
    this.device = device;
  }

  // A new walk. What the walk before left behind must have been stored.
  begin() {
    return this.inTurn(async () => {
      const session = { id: crypto.randomUUID(), last: 0, stored: 0, bytes: 0, loads: 0, counts: {}, ended: false };
      const write = this.database.transaction(STORES, "readwrite");
      write.objectStore("data").clear();
      write.objectStore("channels").clear();
      write.objectStore("state").put(session, "session");
      await finished(write);
      Object.assign(this, { session, done: null, count: 0 });
    });
  }

  // Another part of the walk, measured by another clock: what the numbers of its channels begin with.
  beginPart() {
    return this.change((session) => {
      session.loads += 1;
    });
  }

  end() {
    return this.change((session) => {
      session.ended = true;
    });
  }

  keepChannel(channel) {
    return this.inTurn(async () => {
      const write = this.database.transaction("channels", "readwrite");
      write.objectStore("channels").put(channel, channel.channel);
      await finished(write);
    });
  }

  channel(number) {
    return request(this.database.transaction("channels").objectStore("channels").get(number));
  }

  // Takes a message; it has its number when it is stored.
  add(channel, deviceNs, payload) {
    this.waiting.push({ channel, deviceNs, payload });
    if (!this.timer) {
      this.timer = setTimeout(() => {
        this.timer = null;
        this.flush().catch((error) => this.onFailure?.(error));
      }, WRITE_EVERY_MS);
    }
  }

  flush() {
    return this.inTurn(async () => {
      const records = this.waiting;
      if (records.length === 0 || !this.session) return;
      this.waiting = [];
      const session = { ...this.session, counts: { ...this.session.counts } };
      const write = this.database.transaction(["state", "data"], "readwrite");
      for (const record of records) {
        session.last += 1;
        session.bytes += record.payload.length;
        session.counts[record.channel] = (session.counts[record.channel] ?? 0) + 1;
        write.objectStore("data").put(record, session.last);
      }
      write.objectStore("state").put(session, "session");
      try {
        await finished(write);
      } catch (error) {
        // Nothing of it was written, and nothing has a number.
        this.waiting = records.concat(this.waiting);
        throw error;
      }
      this.session = session;
      this.count += records.length;
      this.onStored?.();
    });
  }

  // Messages from a number on: pairs of number and message.
  async read(from, most) {
    const store = this.database.transaction("data").objectStore("data");
    const range = IDBKeyRange.lowerBound(from);
    const [keys, records] = await Promise.all([request(store.getAllKeys(range, most)), request(store.getAll(range, most))]);
    return keys.map((seq, n) => ({ seq, ...records[n] }));
  }

  // The rig has everything up to a number.
  forget(upTo) {
    return this.inTurn(async () => {
      if (!this.session || upTo <= this.session.stored) return;
      const range = IDBKeyRange.upperBound(upTo);
      const session = { ...this.session, stored: upTo };
      const write = this.database.transaction(["state", "data"], "readwrite");
      const store = write.objectStore("data");
      const gone = await request(store.getAll(range));
      session.bytes -= gone.reduce((sum, record) => sum + record.payload.length, 0);
      store.delete(range);
      write.objectStore("state").put(session, "session");
      await finished(write);
      this.session = session;
      this.count -= gone.length;
    });
  }

  // The walk is with the rig, whole; or nobody took any of it.
  close() {
    return this.inTurn(async () => {
      const write = this.database.transaction("state", "readwrite");
      write.objectStore("state").delete("session");
      await finished(write);
      this.done = this.session;
      this.session = null;
    });
  }

  change(how) {
    return this.inTurn(async () => {
      const session = { ...this.session };
      how(session);
      const write = this.database.transaction("state", "readwrite");
      write.objectStore("state").put(session, "session");
      await finished(write);
      this.session = session;
    });
  }

  inTurn(action) {
    const done = this.last.then(action);
    this.last = done.catch(() => {});
    return done;
  }
}
