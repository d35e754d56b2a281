// The WebSocket: numbered messages, resumed after a break, reconnecting at 1, 2, 4 … 30 s.
import { isAlive } from '../app/api.js';

const SILENCE_MS = 2500; // then the service is asked whether it is alive
const DEAD_MS = 20000; // heartbeats come every 15 s: nothing for longer means a dead line
const LONGEST_WAIT_S = 30;

export class Stream {
  /**
   * Alarms and jobs of all assets; live messages of those that are followed: ids, or null for all.
   *
   * handlers: message(message), up(), down({ nextTryMs }), refused() when the session is over.
   */
  constructor(handlers, followed = null) {
    this.handlers = handlers;
    this.followed = followed;
    this.epoch = null;
    this.sequence = null;
    this.failures = 0;
    this.stopped = false;
    this.watch = setInterval(() => this.checkSilence(), 1000);
    this.connect();
  }

  stop() {
    this.stopped = true;
    clearInterval(this.watch);
    clearTimeout(this.retry);
    this.drop();
  }

  /** Follow other assets from now on; gives whether that opens the line again, with its greetings. */
  follow(followed) {
    if (String(followed) === String(this.followed)) return false;
    this.followed = followed;
    if (this.socket) {
      this.drop();
      this.connect();
    }
    return true;
  }

  tryNow() {
    clearTimeout(this.retry);
    if (!this.socket) this.connect();
  }

  address() {
    const query = new URLSearchParams(this.followed ? { live: this.followed.join(',') } : {});
    if (this.sequence !== null) {
      query.set('resume', String(this.sequence));
      query.set('epoch', this.epoch);
    }
    const scheme = location.protocol === 'https:' ? 'wss' : 'ws';
    return `${scheme}://${location.host}/api/v1/stream?${query}`;
  }

  connect() {
    const socket = new WebSocket(this.address());
    this.socket = socket;
    this.heardAt = performance.now();
    socket.onmessage = (event) => this.receive(socket, event);
    socket.onclose = () => this.lost(socket);
  }

  receive(socket, event) {
    if (socket !== this.socket) return;
    this.heardAt = performance.now();
    const message = JSON.parse(event.data);
    if (message.type === 'hello') {
      this.failures = 0;
      this.handlers.up();
    }
    if (Number.isInteger(message.seq)) this.sequence = message.seq;
    this.epoch = message.epoch ?? this.epoch;
    this.handlers.message(message);
  }

  drop() {
    const socket = this.socket;
    this.socket = null;
    if (!socket) return;
    socket.onmessage = socket.onclose = null;
    // A line that is not open yet is closed as soon as it is: browsers complain about anything else.
    if (socket.readyState === WebSocket.CONNECTING) socket.onopen = () => socket.close();
    else socket.close();
  }

  lost(socket) {
    if (socket !== this.socket || this.stopped) return;
    this.socket = null;
    this.waitAndConnect();
  }

  async waitAndConnect() {
    this.failures += 1;
    const waitS = Math.min(LONGEST_WAIT_S, 2 ** (this.failures - 1));
    this.handlers.down({ nextTryMs: Date.now() + waitS * 1000 });
    this.retry = setTimeout(() => this.connect(), waitS * 1000);
    // A refused upgrade looks like any lost line: only the session shows the difference.
    if (await this.handlers.refused()) this.stop();
  }

  async checkSilence() {
    const silentMs = performance.now() - this.heardAt;
    if (!this.socket || silentMs < SILENCE_MS || this.asking) return;
    this.asking = true;
    const asked = this.socket;
    const dead = silentMs > DEAD_MS || !(await isAlive());
    this.asking = false;
    if (!dead || asked !== this.socket || this.stopped) return;
    this.drop();
    this.waitAndConnect();
  }
}
