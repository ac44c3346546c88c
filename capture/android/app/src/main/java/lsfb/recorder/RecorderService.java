package lsfb.recorder;

import android.app.Notification;
import android.app.NotificationChannel;
import android.app.NotificationManager;
import android.app.Service;
import android.content.Context;
import android.content.Intent;
import android.content.SharedPreferences;
import android.os.Handler;
import android.os.HandlerThread;
import android.os.IBinder;
import android.os.PowerManager;
import android.os.SystemClock;
import android.util.Base64;
import java.io.File;
import java.io.IOException;
import java.security.SecureRandom;
import java.util.UUID;
import lsfb.sidecar.PairingCode;
import lsfb.sidecar.Phone;
import lsfb.sidecar.Records;
import lsfb.sidecar.Session;
import lsfb.sidecar.Spool;

/** A walk in the foreground, with the screen on or off: extras {@code code} (the rig's pairing code) and {@code device} (the phone's name). */
public final class RecorderService extends Service {
  private static final String CHANNEL = "walk";
  private static final int NOTIFICATION = 1;

  private PowerManager.WakeLock awake;
  private HandlerThread measuring;
  private Sensors sensors;
  private Radio radio;
  private Frames frames;
  private Phone phone;

  @Override
  public int onStartCommand(Intent intent, int flags, int startId) {
    NotificationManager manager = (NotificationManager) getSystemService(Context.NOTIFICATION_SERVICE);
    manager.createNotificationChannel(new NotificationChannel(CHANNEL, "Walk", NotificationManager.IMPORTANCE_LOW));
    startForeground(NOTIFICATION, notification("recording"));
    if (intent == null || phone != null) {
      return START_NOT_STICKY;
    }
    PowerManager power = (PowerManager) getSystemService(Context.POWER_SERVICE);
    awake = power.newWakeLock(PowerManager.PARTIAL_WAKE_LOCK, "lsfb:walk");
    awake.acquire();
    try {
      begin(new PairingCode(intent.getStringExtra("code")), intent.getStringExtra("device"));
    } catch (IOException | IllegalArgumentException e) {
      manager.notify(NOTIFICATION, notification(e.getMessage()));
    }
    return START_NOT_STICKY;
  }

  private void begin(PairingCode rig, String device) throws IOException {
    String name = UUID.randomUUID().toString();
    Spool spool = new Spool(new File(getFilesDir(), "walks/" + name));
    Session session = new Session(name, device, key(), rig.token, spool, Records.BOOT_CLOCK);
    NotificationManager manager = (NotificationManager) getSystemService(Context.NOTIFICATION_SERVICE);
    Outlet outlet = new Outlet(session, device, words -> manager.notify(NOTIFICATION, notification(words)));
    phone = new Phone(session, spool, rig, SystemClock::elapsedRealtimeNanos);
    new Thread(phone, "sidecar-send").start();
    measuring = new HandlerThread("measuring");
    measuring.start();
    Handler thread = new Handler(measuring.getLooper());
    sensors = new Sensors(this, outlet);
    radio = new Radio(this, outlet);
    frames = new Frames(this, outlet);
    sensors.start(thread);
    radio.start(thread);
    frames.start(thread);
  }

  @Override
  public void onDestroy() {
    if (phone != null) {
      sensors.stop();
      radio.stop();
      frames.stop();
      measuring.quitSafely();
      // What is spooled is sent on, as long as the process is left alone.
      phone.end();
    }
    if (awake != null) {
      awake.release();
    }
    super.onDestroy();
  }

  @Override
  public IBinder onBind(Intent intent) {
    return null;
  }

  /** What this phone proves with that it was paired; made once. Files of an app are its own. */
  private byte[] key() {
    SharedPreferences kept = getSharedPreferences("sidecar", MODE_PRIVATE);
    String text = kept.getString("key", null);
    if (text == null) {
      byte[] random = new byte[32];
      new SecureRandom().nextBytes(random);
      text = Base64.encodeToString(random, Base64.NO_WRAP);
      kept.edit().putString("key", text).commit();
    }
    return Base64.decode(text, Base64.NO_WRAP);
  }

  private Notification notification(String words) {
    return new Notification.Builder(this, CHANNEL)
        .setSmallIcon(android.R.drawable.ic_menu_camera)
        .setContentTitle("LSFB recorder")
        .setContentText(words)
        .build();
  }
}
