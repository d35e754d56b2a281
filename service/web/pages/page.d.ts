// Types of the page that no module can say for itself. Those of the answers (namespace Api) are made
// from docs/openapi.json: see tools/page_types.py.

declare const uPlot: any;

declare namespace Page {
  interface Options {
    method?: 'GET' | 'POST' | 'PUT' | 'PATCH' | 'DELETE';
    body?: object;
    file?: Blob;
    query?: { [name: string]: any };
    headers?: { [name: string]: string };
    timeoutMs?: number;
    signal?: AbortSignal;
  }

  type Key<P extends string, O> = `${O extends { method: infer M extends string } ? M : 'GET'} ${P}`;
  /** What a request gives; `any` for an address that is put together of parts. */
  type Answer<P extends string, O> = Key<P, O> extends keyof Api.Answers ? Api.Answers[Key<P, O>] : any;
  /** Of an item that may have one of several forms: whatever one of them has. */
  type Item<P extends string> = Answer<P, {}> extends { items: Array<infer I> } ? Merged<I> : any;
  type Merged<U> = {
    [K in U extends any ? keyof U : never]?: U extends any ? (K extends keyof U ? U[K] : undefined) : never;
  };

  type Call = <P extends string, const O extends Options = {}>(path: P, options?: O) => Promise<Answer<P, O>>;
  type CallPages = <P extends string>(path: P, query?: object, look?: (page: Answer<P, {}>) => void,
    signal?: AbortSignal) => Promise<Item<P>[]>;
  /** Not the address itself, but the path under which the description has its answer. */
  type AssetPath = <R extends string = ''>(assetId: string, rest?: R) => `/assets/{asset_id}${R}`;

  /** What `service/web/pages/views.py` has read of a view. */
  interface View {
    title: string;
    from: string;
    of?: string;
    hidden?: boolean;
    style?: boolean;
  }

  interface Dialog {
    title: any;
    body: any;
    confirm?: string;
    buttons?: any[];
    look?: string;
  }

  interface Tile {
    look?: string;
    label?: string;
    title?: any;
    symbol?: any;
    word?: any;
    figure?: any;
    note?: any;
    why?: any;
    small?: any;
    record?: string;
    extra?: any;
    doubtful?: boolean;
  }
}
