export class WhatIfView { destroy() {} }
