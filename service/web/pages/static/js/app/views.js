// Written by service/web/pages/views.py from the second lines of ../*/view.js. Do not edit.
/** @type {{ [name: string]: Page.View }} */
export const VIEWS = {
  fleet: { title: 'Fleet', from: 'viewer', of: 'all' },
  operator: { title: 'Operator', from: 'viewer', style: false },
  whatif: { title: 'What-if', from: 'operator' },
  envelope: { title: 'Envelope', from: 'viewer' },
  engineer: { title: 'Engineer', from: 'engineer' },
  history: { title: 'History', from: 'viewer' },
  accuracy: { title: 'Accuracy', from: 'viewer' },
  alarms: { title: 'Alarms', from: 'viewer', of: 'all', style: false },
  assets: { title: 'Assets', from: 'engineer', of: 'none' },
  commissioning: { title: 'Commissioning', from: 'admin', of: 'none', hidden: true },
};
