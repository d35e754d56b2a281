// A profile to try: its steps as { speed_rpm, load_n, minutes }, as link, as file. Pure functions.
export const MOST_STEPS = 12;
const BEYOND = { speed_rpm: 1.6, load_n: 2.2 }; // as far as the map of the envelope reaches
const STEP_SIGN = '-';
const FIGURE_SIGN = '_';
const roundUp = (value, unit) => Math.ceil(value / unit) * unit;

/** Fineness of a slider: 50 up to 20 000, coarser where a machine carries far more. */
const fineness = (high) => [50, 100, 200, 500, 1000, 2000].find((one) => high / one <= 400) ?? 5000;

/**
 * What can be changed of a step, with the reach of the sliders for an asset: well beyond its
 * low-risk region and beyond everything that it does or is to do.
 */
export function fieldsFor(lowRisk, steps) {
  const reach = (name, region) => {
    const highest = Math.max(region * BEYOND[name], ...steps.map((step) => step[name]));
    return roundUp(highest, highest > 1e4 ? 5000 : 500);
  };
  const speed = reach('speed_rpm', lowRisk?.speed_rpm_max ?? 4300);
  const load = reach('load_n', lowRisk?.load_n_max ?? 3000);
  return {
    speed_rpm: { name: 'Speed', unit: 'rpm', low: 0, high: speed, step: fineness(speed), most: 20000 },
    load_n: { name: 'Load', unit: 'N', low: 0, high: load, step: fineness(load), most: 200000 },
    minutes: { name: 'Duration', unit: 'min', low: 5, high: 240, step: 5, least: 1, most: 1440 },
  };
}

/** The profile as the service takes it; `before` is what is left of the present step, or null. */
export function requestProfile(steps, before) {
  const profile = steps.map(({ speed_rpm, load_n, minutes }) =>
    ({ duration_s: minutes * 60, speed_rpm, load_n }));
  if (!before) return profile;
  const { duration_s, speed_rpm, load_n } = before;
  return [{ duration_s, speed_rpm, load_n }, ...profile];
}

export function linkOf(steps, fromEnd) {
  const text = steps.map(({ speed_rpm, load_n, minutes }) =>
    [speed_rpm, load_n, minutes].join(FIGURE_SIGN)).join(STEP_SIGN);
  return new URLSearchParams({ steps: text, ...(fromEnd ? { from: 'end' } : {}) }).toString();
}

/** The reverse: { steps, fromEnd }, or null where a link holds no valid profile. */
export function fromLink(query) {
  const parameters = new URLSearchParams(query);
  const steps = (parameters.get('steps') ?? '').split(STEP_SIGN).filter(Boolean).map((text) => {
    const [speed_rpm, load_n, minutes] = text.split(FIGURE_SIGN).map(Number);
    return { speed_rpm, load_n, minutes };
  });
  const fields = Object.entries(fieldsFor(null, []));
  const sound = steps.every((step) => fields.every(([name, { least = 0, most }]) =>
    step[name] >= least && step[name] <= most));
  if (!steps.length || !sound) return null;
  return { steps: steps.slice(0, MOST_STEPS), fromEnd: parameters.get('from') === 'end' };
}

/** The file that `bearing-twin forecast --profile` reads. */
export function csvOf(profile, ambient) {
  const lines = ['time_s,speed_rpm,load_n,ambient_c'];
  let at = 0;
  for (const { duration_s, speed_rpm, load_n } of [...profile, { ...profile.at(-1), duration_s: 0 }]) {
    lines.push([at, speed_rpm, load_n, ambient ?? ''].join());
    at += Math.round(duration_s);
  }
  return `${lines.join('\n')}\n`;
}
