// A tone as long as an alarm waits for its acknowledgement: off until a user of this browser asks.
const STORED = 'alarm-sound';
/** Tone by priority: pitch in Hz, beeps in a row, ms from one row to the next. */
const TONES = {
  1: { pitch: 880, beeps: 3, everyMs: 2500 },
  2: { pitch: 660, beeps: 2, everyMs: 6000 },
  3: { pitch: 440, beeps: 1, everyMs: 15000 },
};
const BEEP_S = 0.16;
const GAP_S = 0.1;
const LOUDNESS = 0.25;

export class AlarmSound {
  constructor(alarms) {
    this.alarms = alarms;
    const stored = Number(localStorage.getItem(STORED));
    this.lowest = stored in TONES ? stored : 0;
    this.context = null;
    this.nextMs = 0;
    this.known = [];
    // Browsers make no sound before the user has done something on the page.
    for (const event of ['pointerdown', 'keydown']) {
      document.addEventListener(event, () => this.lowest && this.wake());
    }
  }

  /** The lowest priority that sounds: 1 to 3, or 0 for none; call it when the user chooses. */
  choose(lowest) {
    this.lowest = lowest;
    if (lowest) localStorage.setItem(STORED, String(lowest));
    else localStorage.removeItem(STORED);
    this.known = this.waiting();
    if (lowest) {
      this.wake();
      this.play(lowest); // so that the user knows it works, and how loud it is
      this.nextMs = performance.now() + TONES[1].everyMs;
    }
  }

  waiting() {
    return this.lowest ? this.alarms().filter((alarm) =>
      alarm.state === 'UNACK' && alarm.priority <= this.lowest) : [];
  }

  get isOn() {
    return Boolean(this.lowest) && this.context?.state === 'running';
  }

  get waits() {
    return Boolean(this.lowest) && !this.isOn;
  }

  wake() {
    this.context ??= new AudioContext();
    if (this.context.state === 'suspended') this.context.resume().catch(() => {});
  }

  tick() {
    const waiting = this.waiting();
    const known = new Set(this.known.map((alarm) => alarm.id));
    const isNew = waiting.some((alarm) => !known.has(alarm.id)); // heard at once
    this.known = waiting;
    const now = performance.now();
    if (!waiting.length || (now < this.nextMs && !isNew) || this.waits) return;
    const worst = Math.min(...waiting.map((alarm) => alarm.priority));
    this.nextMs = now + TONES[worst].everyMs;
    this.play(worst);
  }

  play(priority) {
    const { pitch, beeps } = TONES[priority];
    const { context } = this;
    for (let i = 0; i < beeps; i += 1) {
      const begin = context.currentTime + i * (BEEP_S + GAP_S);
      const tone = context.createOscillator();
      const volume = context.createGain();
      tone.frequency.value = pitch;
      volume.gain.setValueAtTime(0, begin);
      volume.gain.linearRampToValueAtTime(LOUDNESS, begin + 0.02);
      volume.gain.setValueAtTime(LOUDNESS, begin + BEEP_S - 0.02);
      volume.gain.linearRampToValueAtTime(0, begin + BEEP_S);
      tone.connect(volume).connect(context.destination);
      tone.start(begin);
      tone.stop(begin + BEEP_S);
    }
  }
}
