export class EngineerView { destroy() {} }
