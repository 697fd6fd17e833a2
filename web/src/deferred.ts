// A promise that is resolved or rejected from outside.

export interface Deferred {
  promise: Promise<void>;
  resolve: () => void;
  reject: (error: Error) => void;
  settled: boolean;
}

export function deferred(): Deferred {
  let resolve!: () => void;
  let reject!: (error: Error) => void;
  const promise = new Promise<void>((yes, no) => ([resolve, reject] = [yes, no]));
  // The console reports a rejected promise without a handler. The page shows the error itself, so
  // an empty handler prevents a second report.
  promise.catch(() => undefined);
  const made: Deferred = {
    promise,
    settled: false,
    resolve: () => {
      made.settled = true;
      resolve();
    },
    reject: (error) => {
      made.settled = true;
      reject(error);
    },
  };
  return made;
}
