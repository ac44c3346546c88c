package lsfb.recorder;

import android.bluetooth.BluetoothManager;
import android.bluetooth.le.BluetoothLeScanner;
import android.bluetooth.le.ScanCallback;
import android.bluetooth.le.ScanSettings;
import android.content.BroadcastReceiver;
import android.content.Context;
import android.content.Intent;
import android.content.IntentFilter;
import android.net.wifi.ScanResult;
import android.net.wifi.WifiManager;
import android.os.Handler;
import android.os.SystemClock;
import java.util.HashMap;
import java.util.List;
import java.util.Map;
import lsfb.sidecar.Records;
import lsfb.sidecar.ScanThrottle;

/** Wi-Fi scans and Bluetooth advertisements. Somebody else's scans are taken as well: they cost none of ours. */
final class Radio extends BroadcastReceiver {
  private static final long LOOK_EVERY_MS = 3_000;

  private final Context context;
  private final Outlet outlet;
  private final WifiManager wifi;
  private final ScanThrottle throttle = new ScanThrottle();
  private Handler thread;
  private int scan;
  private long startedNs;

  private final ScanCallback adverts =
      new ScanCallback() {
        @Override
        public void onScanResult(int type, android.bluetooth.le.ScanResult heard) {
          byte[] raw = heard.getScanRecord() == null ? new byte[0] : heard.getScanRecord().getBytes();
          long timeNs = heard.getTimestampNanos();
          outlet.put(Outlet.BLE, timeNs, Records.ble(timeNs, "ble", heard.getDevice().getAddress(), heard.getRssi(), raw));
        }

        @Override
        public void onScanFailed(int code) {
          outlet.problem("Bluetooth scan failed: " + code);
        }
      };

  Radio(Context context, Outlet outlet) {
    this.context = context;
    this.outlet = outlet;
    wifi = (WifiManager) context.getApplicationContext().getSystemService(Context.WIFI_SERVICE);
  }

  void start(Handler thread) {
    this.thread = thread;
    context.registerReceiver(this, new IntentFilter(WifiManager.SCAN_RESULTS_AVAILABLE_ACTION), null, thread);
    BluetoothManager bluetooth = (BluetoothManager) context.getSystemService(Context.BLUETOOTH_SERVICE);
    BluetoothLeScanner scanner = bluetooth.getAdapter() == null ? null : bluetooth.getAdapter().getBluetoothLeScanner();
    if (scanner == null) {
      outlet.problem("Bluetooth is off");
    } else {
      // Once: Android allows five starts in half a minute.
      ScanSettings often = new ScanSettings.Builder().setScanMode(ScanSettings.SCAN_MODE_LOW_LATENCY).build();
      scanner.startScan(null, often, adverts);
    }
    scanAgain();
  }

  void stop() {
    context.unregisterReceiver(this);
    thread.removeCallbacksAndMessages(null);
    BluetoothManager bluetooth = (BluetoothManager) context.getSystemService(Context.BLUETOOTH_SERVICE);
    if (bluetooth.getAdapter() != null && bluetooth.getAdapter().getBluetoothLeScanner() != null) {
      bluetooth.getAdapter().getBluetoothLeScanner().stopScan(adverts);
    }
  }

  @SuppressWarnings("deprecation")
  private void scanAgain() {
    // Tried even when it may be refused: where throttling is switched off it is not.
    startedNs = SystemClock.elapsedRealtimeNanos();
    throttle.started(startedNs, wifi.startScan());
    outlet.show(throttle.sentence());
    thread.postDelayed(this::scanAgain, LOOK_EVERY_MS);
  }

  @Override
  public void onReceive(Context context, Intent intent) {
    long nowNs = SystemClock.elapsedRealtimeNanos();
    boolean wasOurs = intent.getBooleanExtra(WifiManager.EXTRA_RESULTS_UPDATED, false);
    List<ScanResult> results = wifi.getScanResults();
    Map<String, Long> heardNs = new HashMap<>();
    for (ScanResult result : results) {
      // Microseconds since the start.
      heardNs.put(result.BSSID, result.timestamp * 1_000);
    }
    boolean areNew = throttle.areNew(heardNs);
    outlet.show(throttle.sentence());
    scan++;
    // Old ones too, with their old times: the rig's doctor says how many.
    for (ScanResult result : results) {
      long timeNs = result.timestamp * 1_000;
      outlet.put(
          Outlet.WIFI,
          timeNs,
          Records.wifiReading(timeNs, "wifi", scan, result.BSSID, String.valueOf(result.SSID), result.frequency, result.level));
    }
    long since = wasOurs && areNew ? startedNs : 0;
    outlet.put(
        Outlet.WIFI_SCAN, nowNs, Records.wifiScan(nowNs, "wifi", scan, since, since == 0 ? 0 : nowNs, results.size()));
  }
}
