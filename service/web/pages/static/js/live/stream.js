// The WebSocket: numbered messages, resumed after a break, reconnecting at 1, 2, 4 … 30 s.
import { isAlive } from '../app/api.js';
import { ageMs, LONGEST_SILENCE_MS, thisMoment } from './age.js';

const SILENCE_MS = 2500; // then the service is asked whether it is alive
const NO_HEARTBEAT_MS = 20000; // heartbeats come every 15 s, also where no asset is followed
const DOUBTED_MS = 3000; // silence of a line that has to show itself again after a sleep, a new network
const LONGEST_WAIT_S = 30;
/** When a machine wakes up, a page is looked at again, or there is a network again.
 *  @type {[EventTarget, string][]} */
const RETURNS = [[document, 'visibilitychange'], [window, 'pageshow'], [window, 'online']];

export class Stream {
  /**
   * Alarms and jobs of all assets; live messages of those that are followed: ids, or null for all.
   *
   * handlers: message(message), up(), down({ heard, nextTryMs }) with the moment of the last message,
   * refused() when the session is over, hears() whether any asset is followed.
   */
  constructor(handlers, followed = null) {
    this.handlers = handlers;
    this.followed = followed;
    this.epoch = null;
    this.sequence = null;
    this.failures = 0;
    this.stopped = false;
    this.heard = thisMoment();
    this.watch = setInterval(() => this.checkSilence(), 1000);
    this.ending = new AbortController();
    for (const [target, event] of RETURNS) {
      target.addEventListener(event, () => this.wake(), { signal: this.ending.signal });
    }
    this.connect();
  }

  stop() {
    this.stopped = true;
    this.ending.abort();
    clearInterval(this.watch);
    clearTimeout(this.retry);
    this.drop();
  }

  /** Follow other assets from now on; gives whether that opens the line again, with its greetings. */
  follow(followed) {
    if (String(followed) === String(this.followed)) return false;
    this.followed = followed;
    if (this.socket) this.connectAgain();
    return true;
  }

  /** Open another line instead of this one; how long nothing was heard goes on to count. */
  connectAgain() {
    const { since } = this;
    this.drop();
    this.connect(since);
  }

  tryNow() {
    clearTimeout(this.retry);
    this.drop(true);
    this.connect();
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

  /** since: the moment from which on silence counts. */
  connect(since = thisMoment()) {
    const socket = new WebSocket(this.address());
    this.socket = socket;
    this.since = since;
    socket.onmessage = (event) => this.receive(socket, event);
    socket.onclose = () => this.lost(socket);
  }

  receive(socket, event) {
    if (socket !== this.socket) return;
    // What waited in a machine that slept is old: the line is opened again before any of it is shown.
    if (this.isSilent()) {
      this.giveUp();
      return;
    }
    this.heard = this.since = thisMoment();
    const message = JSON.parse(event.data);
    if (message.type === 'hello') {
      this.failures = 0;
      this.handlers.up();
    }
    if (Number.isInteger(message.seq)) this.sequence = message.seq;
    this.epoch = message.epoch ?? this.epoch;
    this.handlers.message(message);
  }

  drop(atOnce = ageMs(this.since) > SILENCE_MS) {
    const socket = this.socket;
    this.socket = null;
    if (!socket) return;
    socket.onmessage = socket.onclose = null;
    // A line that is not open yet is closed as soon as it is: browsers complain about anything else. But
    // one that does not get on has to go: they open no other to the same host meanwhile.
    if (socket.readyState === WebSocket.CONNECTING && !atOnce) socket.onopen = () => socket.close();
    else socket.close();
  }

  lost(socket) {
    if (socket !== this.socket || this.stopped) return;
    this.socket = null;
    this.waitAndConnect();
  }

  /** The line is dead though it is open: one that had been up is opened again at once. */
  giveUp() {
    this.drop();
    this.waitAndConnect(this.failures === 0);
  }

  async waitAndConnect(atOnce = false) {
    const waitS = atOnce ? 0 : Math.min(LONGEST_WAIT_S, 2 ** this.failures);
    this.failures += 1;
    this.handlers.down({ heard: this.heard, nextTryMs: Date.now() + waitS * 1000 });
    this.retry = setTimeout(() => this.connect(), waitS * 1000);
    // A refused upgrade looks like any lost line: only the session shows the difference.
    if (await this.handlers.refused()) this.stop();
  }

  /** A service that is slow to answer a new line is not taken for a dead one as soon. */
  isSilent() {
    const isUp = this.failures === 0 && this.handlers.hears();
    return ageMs(this.since) > (isUp ? LONGEST_SILENCE_MS : NO_HEARTBEAT_MS);
  }

  checkSilence() {
    if (!this.socket) return;
    if (this.isSilent()) this.giveUp();
    else if (ageMs(this.since) > SILENCE_MS && !this.asking) this.askWhetherAlive();
  }

  async askWhetherAlive() {
    this.asking = true;
    const asked = this.socket;
    const alive = await isAlive();
    this.asking = false;
    if (!alive && asked === this.socket && ageMs(this.since) > SILENCE_MS) this.giveUp();
  }

  wake() {
    if (document.visibilityState === 'hidden') return;
    if (!this.socket) this.tryNow();
    else if (this.isSilent()) this.giveUp();
    else if (ageMs(this.since) > DOUBTED_MS) this.connectAgain();
  }
}
