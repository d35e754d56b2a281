// What the page uses of Preact, for the check of types alone; the browser does not fetch it.

/** A component; its fields are set where its data come, so any name is one. */
export class Component {
  constructor(attributes?: any);
  props: any;
  forceUpdate(after?: () => void): void;
  componentDidMount?(): void;
  componentDidUpdate?(): void;
  componentWillUnmount?(): void;
  shouldComponentUpdate?(next: any): boolean;
  [field: string]: any;
}
export function h(type: any, attributes?: any, ...children: any[]): any;
export function isValidElement(value: any): boolean;
export function render(node: any, box: any): void;
