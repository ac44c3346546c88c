// The connection to the rig: says who it is, asks the time, sends what the spool holds, and comes back whenever it was lost.

import * as wire from "./wire.js";

const SUBPROTOCOL = "lsfb.sidecar.v1";
// Pauses before the next attempt, milliseconds.
const FIRST_PAUSE_MS = 500;
const LONGEST_PAUSE_MS = 5_000;
// Exchanges of times: so many at the beginning, then one a second.
const EAGER_EXCHANGES = 10;
const EAGER_MS = 50;
const CALM_MS = 1_000;
// A rig that does not say anything for so long is gone: it answers the time every second.
const SILENCE_MS = 10_000;
// Messages that are read from the spool at once, and bytes that may wait in the socket.
const READ_AT_ONCE = 16;
const MOST_BUFFERED_BYTES = 1 << 20;
// Refusals that do not pass by themselves: not paired, wrong code, name taken, bad topic, another window of this browser.
const FINAL_CODES = [1, 2, 3, 7, 11];

export const nowNs = () => BigInt(Math.round(performance.now() * 1e6));

export class Link {
  state = "off";
  pauseMs = FIRST_PAUSE_MS;
  exchanges = 0;

  constructor(spool, clockId) {
    this.spool = spool;
    this.clockId = clockId;
  }

  // Connects, and stays so until told to end.
  start(token) {
    this.token = token;
    this.wanted = true;
    if (!this.socket) this.connect();
  }

  stop() {
    this.wanted = false;
    clearTimeout(this.again);
    this.socket?.close();
  }

  connect() {
    const { session, device } = this.spool;
    if (!this.wanted || !session || !device) return;
    this.tell("connecting");
    const socket = new WebSocket(`wss://${location.host}/v1/stream`, SUBPROTOCOL);
    socket.binaryType = "arraybuffer";
    // What belongs to this connection alone.
    Object.assign(this, { socket, advertised: new Set(), sent: null, sentBytes: 0, credit: 0, last: null, asked: 0, saidBye: false });
    this.heardAt = performance.now();
    socket.onopen = async () => {
      const [first] = await this.spool.read(1, 1);
      if (this.socket !== socket) return;
      const payload = wire.hello({
        session: session.id,
        firstUnacked: first?.seq ?? this.spool.session.last + 1,
        device: device.name,
        key: device.key,
        token: device.isPaired ? null : this.token,
      });
      socket.send(wire.envelope(wire.KIND.hello, { payload }));
    };
    socket.onmessage = (event) => {
      const arrivedNs = nowNs();
      this.heardAt = performance.now();
      if (this.socket === socket) this.take(socket, new Uint8Array(event.data), arrivedNs);
    };
    socket.onclose = () => this.lost(socket);
    this.watch ??= setInterval(() => this.look(), 1_000);
  }

  look() {
    if (this.socket && performance.now() - this.heardAt > SILENCE_MS) {
      const socket = this.socket;
      socket.close();
      this.lost(socket);
    }
    this.pump();
  }

  lost(socket) {
    if (this.socket !== socket) return;
    this.socket = null;
    clearTimeout(this.asking);
    if (!this.wanted) return this.tell("off");
    this.tell("gone");
    this.again = setTimeout(() => this.connect(), this.pauseMs);
    this.pauseMs = Math.min(this.pauseMs * 2, LONGEST_PAUSE_MS);
  }

  take(socket, bytes, arrivedNs) {
    const said = wire.parseEnvelope(bytes);
    if (said.kind === wire.KIND.ack) this.acknowledged(socket, said.seq);
    else if (said.kind === wire.KIND.credit) {
      this.credit = said.seq;
      this.pump();
    } else if (said.kind === wire.KIND.timeResponse) this.answered(socket, wire.parseTimeResponse(said.payload), arrivedNs);
    else if (said.kind === wire.KIND.state) {
      const { code, text } = wire.parseState(said.payload);
      this.refusal = text;
      if (FINAL_CODES.includes(code)) this.wanted = false;
      this.onRefused?.(code, text);
    }
  }

  async acknowledged(socket, seq) {
    if (this.state !== "connected") {
      // It knows this browser, and where the walk goes on.
      this.pauseMs = FIRST_PAUSE_MS;
      this.refusal = null;
      this.tell("connected");
      this.ask(socket);
      if (!this.spool.device.isPaired) await this.spool.keepDevice({ ...this.spool.device, isPaired: true });
    }
    // The rig ends the connection behind this one.
    const isWhole = this.saidBye && seq >= this.spool.session.last;
    if (isWhole) this.wanted = false;
    await this.spool.forget(seq);
    if (isWhole) {
      await this.spool.close();
      socket.close();
      this.onFinished?.();
    } else if (this.socket === socket) {
      this.sent ??= seq;
      this.pump();
    }
  }

  // Asks the time ahead of everything that waits: what lies in the socket already cannot be overtaken.
  ask(socket) {
    if (this.socket !== socket || socket.readyState !== WebSocket.OPEN) return;
    const t1 = nowNs();
    const payload = wire.timeRequest(t1, this.clockId, this.last);
    this.last = null;
    socket.send(wire.envelope(wire.KIND.timeRequest, { payload }));
    this.asked += 1;
    this.asking = setTimeout(() => this.ask(socket), this.asked < EAGER_EXCHANGES ? EAGER_MS : CALM_MS);
  }

  answered(socket, answer, arrivedNs) {
    this.last = { ...answer, t4: arrivedNs };
    this.exchanges += 1;
    this.roundTripMs = Number(arrivedNs - answer.t1 - (answer.t3 - answer.t2)) / 1e6;
    this.onChange?.();
  }

  // Sends what may be sent. One at a time reads the spool.
  async pump() {
    const { socket } = this;
    if (this.pumping || !socket || this.sent === null || this.saidBye) return;
    this.pumping = true;
    try {
      while (this.socket === socket && socket.readyState === WebSocket.OPEN) {
        const records = await this.spool.read(this.sent + 1, READ_AT_ONCE);
        if (records.length === 0) {
          this.sayBye(socket);
          return;
        }
        for (const record of records) {
          if (!(await this.send(socket, record))) return;
        }
      }
    } finally {
      this.pumping = false;
      // The connection was replaced meanwhile.
      if (this.socket && this.socket !== socket) this.pump();
    }
  }

  // False: it may not be sent yet.
  async send(socket, { seq, channel, deviceNs, payload }) {
    if (this.socket !== socket || socket.readyState !== WebSocket.OPEN) return false;
    const bytes = wire.envelope(wire.KIND.data, { channel, seq, deviceNs, payload });
    if (this.sentBytes + bytes.length > this.credit) return false;
    if (socket.bufferedAmount > MOST_BUFFERED_BYTES) {
      setTimeout(() => this.pump(), EAGER_MS);
      return false;
    }
    if (!this.advertised.has(channel)) {
      const described = await this.spool.channel(channel);
      if (this.socket !== socket) return false;
      socket.send(wire.envelope(wire.KIND.advertise, { payload: wire.advertise(described) }));
      this.advertised.add(channel);
    }
    socket.send(bytes);
    this.sentBytes += bytes.length;
    this.sent = seq;
    return true;
  }

  sayBye(socket) {
    const { session } = this.spool;
    if (session.ended && this.sent === session.last) {
      this.saidBye = true;
      socket.send(wire.envelope(wire.KIND.bye, { seq: session.last }));
    }
  }

  tell(state) {
    this.state = state;
    this.onChange?.();
  }
}
